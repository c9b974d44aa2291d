//! The mapping side of a run: the mapper, the steps due to it, the time it used and what ended it.

use std::sync::atomic::Ordering;
use std::thread;
use std::time::{Duration, Instant};

use fgs_splat::{GaussianModel, SparseId};

use super::SlamError;
use super::front::MapSize;
use crate::config::SlamConfig;
use crate::keyframes::Keyframe;
use crate::mapper::{Mapper, MapperError};

/// Spreads a fractional number of steps per frame evenly: after n frames, floor(n * rate) steps.
struct Budget {
    per_frame: f64,
    frames: usize,
    steps: usize,
}

impl Budget {
    fn new(per_frame: f64) -> Self {
        Self {
            per_frame,
            frames: 0,
            steps: 0,
        }
    }

    /// The steps due after one more frame.
    fn next_frame(&mut self) -> usize {
        self.frames += 1;
        let total = (self.frames as f64 * self.per_frame).floor() as usize;
        let due = total - self.steps;
        self.steps = total;
        due
    }
}

/// The mapper, the time it used and what ended it.
pub struct MapperWorker<M> {
    pub mapper: Mapper<M>,
    budget: Budget,
    pub busy: Duration,
    /// Why the mapper cannot go on. The run ends then.
    pub failure: Option<MapperError>,
}

impl<M: GaussianModel> MapperWorker<M> {
    pub fn new(mapper: Mapper<M>, config: &SlamConfig) -> Self {
        Self {
            mapper,
            budget: Budget::new(config.mapping.iterations_per_frame),
            busy: Duration::ZERO,
            failure: None,
        }
    }

    /// Everything that is due after a frame; `None` if the mapper fails.
    pub fn after_frame(
        &mut self,
        keyframe: Option<&Keyframe>,
        map: &MapSize,
    ) -> Option<Vec<SparseId>> {
        let steps = self.budget.next_frame();
        self.work(map, |mapper| {
            keyframe.map_or(Ok(()), |keyframe| mapper.insert(keyframe))?;
            (0..steps).try_for_each(|_| mapper.step())
        })
    }

    /// Lets the mapper work, and reports what became of the map; `None` if the mapper fails.
    pub fn work(
        &mut self,
        map: &MapSize,
        work: impl FnOnce(&mut Mapper<M>) -> Result<(), MapperError>,
    ) -> Option<Vec<SparseId>> {
        let start = Instant::now();
        let changes = work(&mut self.mapper).and_then(|()| self.mapper.take_removed());
        self.busy += start.elapsed();
        map.gaussians
            .store(self.mapper.num_gaussians(), Ordering::Relaxed);
        map.steps.store(self.mapper.steps(), Ordering::Relaxed);
        changes.map_err(|error| self.failure = Some(error)).ok()
    }
}

/// Waits for the mapper's thread.
pub fn join<M>(
    mapping: thread::ScopedJoinHandle<'_, MapperWorker<M>>,
) -> Result<MapperWorker<M>, SlamError> {
    mapping.join().map_err(|_| SlamError::MapperPanicked)
}
