//! The mapping side of a run: the mapper, the steps due to it and the time it used.

use std::sync::atomic::Ordering;
use std::thread;
use std::time::{Duration, Instant};

use fgs_splat::{GaussianModel, SparseChanges};

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

/// The mapper and the time it used.
pub struct MapperWorker<M> {
    pub mapper: Mapper<M>,
    budget: Budget,
    pub busy: Duration,
}

impl<M: GaussianModel> MapperWorker<M> {
    pub fn new(mapper: Mapper<M>, config: &SlamConfig) -> Self {
        Self {
            mapper,
            budget: Budget::new(config.mapping.iterations_per_frame),
            busy: Duration::ZERO,
        }
    }

    /// Everything that is due after a frame.
    pub fn after_frame(
        &mut self,
        keyframe: Option<&Keyframe>,
        map: &MapSize,
    ) -> Result<SparseChanges, MapperError> {
        let start = Instant::now();
        if let Some(keyframe) = keyframe {
            self.mapper.insert(keyframe)?;
        }
        for _ in 0..self.budget.next_frame() {
            self.mapper.step()?;
        }
        Ok(self.report(start, map))
    }

    /// Takes in the keyframe that closes the run. It costs no optimisation step: those are spent.
    pub fn finish(&mut self, keyframe: Option<&Keyframe>) -> Result<(), MapperError> {
        let start = Instant::now();
        if let Some(keyframe) = keyframe {
            self.mapper.insert(keyframe)?;
        }
        self.busy += start.elapsed();
        Ok(())
    }

    pub fn report(&mut self, start: Instant, map: &MapSize) -> SparseChanges {
        self.busy += start.elapsed();
        map.gaussians
            .store(self.mapper.num_gaussians(), Ordering::Relaxed);
        map.steps.store(self.mapper.steps(), Ordering::Relaxed);
        self.mapper.take_sparse_changes()
    }
}

/// Waits for the mapper's thread.
pub fn join<M>(
    mapping: thread::ScopedJoinHandle<'_, Result<MapperWorker<M>, MapperError>>,
) -> Result<MapperWorker<M>, SlamError> {
    match mapping.join() {
        Ok(result) => Ok(result?),
        Err(_) => Err(SlamError::MapperPanicked),
    }
}
