//! A whole run: frames in, trajectory and map out. The only folder with threads, one file a mode.
//!
//! Every mode drives the same [`Tracker`] and [`Mapper`]. The two talk over two channels, and a
//! channel whose other end is gone ends every wait.

mod front;
mod lockstep;
mod parallel;
mod realtime;
mod worker;

use std::error::Error;
use std::fmt;
use std::str::FromStr;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use fgs_geom::{Camera, FrameIndex, RgbdFrame, Se3};
use fgs_splat::{GaussianModel, Gaussians};
use rayon::ThreadPoolBuildError;
use serde::de::IntoDeserializer;
use serde::{Deserialize, Serialize};

use crate::config::{ConfigError, SlamConfig};
use crate::keyframes::KeyframeKind;
use crate::mapper::{Mapper, MapperError};
use crate::observer::Observer;
use crate::tracker::{Tracked, Tracker};
use front::{Front, MapSize};
use worker::MapperWorker;

/// How tracker and mapper take turns.
///
/// As text, in settings and on the command line: the variant's name in lower case.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Execution {
    /// In strict turns on one thread: the same result, bit for bit, every time.
    Lockstep,
    /// On two threads; the tracker waits when the mapper falls behind, so that the map's quality
    /// does not depend on the machine.
    Parallel,
    /// On two threads, each frame at its own time; frames that come too late for the tracker are
    /// dropped, and the mapper does what it can.
    Realtime,
}

impl fmt::Display for Execution {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

impl FromStr for Execution {
    type Err = serde::de::value::Error;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Self::deserialize(text.into_deserializer())
    }
}

/// A run's result.
#[derive(Debug)]
pub struct SlamOutput {
    /// Every frame that was read and not dropped, in order.
    pub frames: Vec<Tracked>,
    /// The keyframes, in order.
    pub keyframes: Vec<KeyframeRecord>,
    /// The map.
    pub gaussians: Gaussians,
    /// Bytes that the map took on a graphics device at the end.
    pub device_bytes: u64,
    /// Frames dropped because they came too late.
    pub frames_dropped: usize,
    /// Frames that could not be read.
    pub frames_damaged: usize,
    /// Where the time went.
    pub timings: Timings,
    /// Why the mapper could not go on, which ended the run early.
    pub failure: Option<MapperError>,
}

/// A keyframe's place in the run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KeyframeRecord {
    /// The frame.
    pub index: FrameIndex,
    /// What it is for.
    pub kind: KeyframeKind,
    /// Its pose.
    pub world_from_camera: Se3,
}

/// Wall-clock times of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Timings {
    /// From the first frame asked for to the last step done, decoding included.
    pub total: Duration,
    /// All the mapper's work.
    pub mapping: Duration,
    /// Optimisation steps taken.
    pub steps: usize,
}

/// Why a run has no result.
#[derive(Debug, thiserror::Error)]
pub enum SlamError {
    /// A setting is impossible.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The threads of tracker or mapper do not start.
    #[error("cannot start the threads that compute: {0}")]
    Threads(#[from] ThreadPoolBuildError),
    /// The mapper panicked.
    #[error("the mapper stopped on an internal error")]
    MapperPanicked,
}

/// Runs the system over `frames`, all of the given camera, until they end, `stop` is set or the
/// mapper fails; in any case everything so far is returned. Frames that are errors are skipped and
/// counted.
///
/// # Errors
/// If the configuration is impossible, threads do not start or the mapper panics.
pub fn run<E: Error + 'static>(
    frames: impl Iterator<Item = Result<RgbdFrame, E>>,
    camera: &Camera,
    config: &SlamConfig,
    execution: Execution,
    model: impl GaussianModel + Send,
    observer: &mut dyn Observer,
    stop: &AtomicBool,
) -> Result<SlamOutput, SlamError> {
    config.validate()?;
    let start = Instant::now();
    let mut front = Front::new(Tracker::new(camera, config), observer, stop);
    let worker = MapperWorker::new(Mapper::new(model, camera, config), config);
    let mut worker = match execution {
        Execution::Lockstep => lockstep::run(frames, &mut front, worker),
        Execution::Parallel => parallel::run(frames, &mut front, worker)?,
        Execution::Realtime => realtime::run(frames, &mut front, worker)?,
    };
    if worker.failure.is_none()
        && let Some(keyframe) = front.finish()
    {
        // It costs no optimisation step: those are spent.
        worker.work(&MapSize::default(), |mapper| mapper.insert(&keyframe));
    }
    Ok(SlamOutput {
        frames: front.frames,
        keyframes: front.keyframes,
        frames_dropped: front.dropped,
        frames_damaged: front.damaged,
        timings: Timings {
            total: start.elapsed(),
            mapping: worker.busy,
            steps: worker.mapper.steps(),
        },
        device_bytes: worker.mapper.device_bytes(),
        gaussians: worker.mapper.into_gaussians(),
        failure: worker.failure,
    })
}
