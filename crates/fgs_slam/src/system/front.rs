//! The tracking side of a run: the tracker and what it has found.

use std::error::Error;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use fgs_geom::RgbdFrame;
use rayon::ThreadPool;

use super::KeyframeRecord;
use crate::keyframes::Keyframe;
use crate::observer::{Observer, SlamEvent};
use crate::tracker::{Tracked, Tracker};

/// The tracker and what it has found.
pub struct Front<'a> {
    pub tracker: Tracker,
    /// The tracker's own threads, if it has any.
    pool: Option<ThreadPool>,
    observer: &'a mut dyn Observer,
    /// Ends the run when set.
    stop: &'a AtomicBool,
    pub frames: Vec<Tracked>,
    pub keyframes: Vec<KeyframeRecord>,
    pub dropped: usize,
    pub damaged: usize,
}

impl<'a> Front<'a> {
    pub fn new(tracker: Tracker, observer: &'a mut dyn Observer, stop: &'a AtomicBool) -> Self {
        Self {
            tracker,
            pool: None,
            observer,
            stop,
            frames: Vec::new(),
            keyframes: Vec::new(),
            dropped: 0,
            damaged: 0,
        }
    }

    /// Gives the tracker threads of its own.
    pub fn compute_on(&mut self, pool: ThreadPool) {
        self.pool = Some(pool);
    }

    /// Hands on each frame that can be read, until they end, the run is stopped, or `None` says that
    /// the mapper is gone.
    pub fn follow<E: Error + 'static>(
        &mut self,
        frames: impl Iterator<Item = Result<RgbdFrame, E>>,
        mut each: impl FnMut(&mut Self, RgbdFrame) -> Option<()>,
    ) {
        let stop = self.stop;
        for frame in frames.take_while(|_| !stop.load(Ordering::Relaxed)) {
            match frame {
                Err(error) => self.skip(&error),
                Ok(frame) => {
                    if each(self, frame).is_none() {
                        break;
                    }
                }
            }
        }
    }

    /// Tracks a frame; the keyframe it becomes, if any.
    pub fn track(&mut self, frame: RgbdFrame, map: &MapSize) -> Option<Keyframe> {
        let frame = Arc::new(frame);
        let tracker = &mut self.tracker;
        let (tracked, keyframe) = match &self.pool {
            Some(pool) => pool.install(|| tracker.track(&frame)),
            None => tracker.track(&frame),
        };
        self.record(keyframe.as_ref());
        self.observer.on(&SlamEvent::Frame {
            tracked: &tracked,
            keyframe: keyframe.as_ref().map(|keyframe| keyframe.kind),
            num_gaussians: map.gaussians.load(Ordering::Relaxed),
            steps: map.steps.load(Ordering::Relaxed),
        });
        self.frames.push(tracked);
        keyframe
    }

    /// The keyframe that closes the run, if any.
    pub fn finish(&mut self) -> Option<Keyframe> {
        let keyframe = self.tracker.finish();
        self.record(keyframe.as_ref());
        keyframe
    }

    fn record(&mut self, keyframe: Option<&Keyframe>) {
        self.keyframes
            .extend(keyframe.map(|keyframe| KeyframeRecord {
                index: keyframe.frame.index,
                kind: keyframe.kind,
                world_from_camera: keyframe.world_from_camera,
            }));
    }

    fn skip(&mut self, error: &(impl Error + 'static)) {
        self.damaged += 1;
        self.observer.on(&SlamEvent::Damaged { error });
    }

    pub fn drop_late(&mut self) {
        self.dropped += 1;
        self.observer.on(&SlamEvent::Dropped);
    }
}

/// What the mapper tells observers of its progress.
#[derive(Default)]
pub struct MapSize {
    pub gaussians: AtomicUsize,
    pub steps: AtomicUsize,
}
