//! A whole run: frames in, trajectory and map out. The only file with threads.
//!
//! Every mode drives the same [`Tracker`] and [`Mapper`]. The two talk over two channels, and a
//! channel whose other end is gone ends every wait.

use std::error::Error;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TryRecvError, bounded, unbounded};
use fgs_geom::{Camera, FrameIndex, RgbdFrame, Se3};
use fgs_splat::{GaussianModel, Gaussians, SparseChanges};

use crate::config::{ConfigError, SlamConfig};
use crate::keyframes::{Keyframe, KeyframeKind};
use crate::mapper::{Mapper, MapperError};
use crate::observer::{Observer, SlamEvent};
use crate::tracker::{Tracked, Tracker};

/// In parallel mode the tracker is at most so many frames ahead of the mapper: enough for both to
/// keep busy across a keyframe, few enough that the map it tracks against is fresh.
const MAX_FRAMES_AHEAD: usize = 10;

/// How tracker and mapper take turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Execution {
    /// In strict turns on one thread: the same result, bit for bit, every time.
    Lockstep,
    /// On two threads; the tracker waits when the mapper falls behind, so that the map's quality
    /// does not depend on the machine.
    Parallel,
    /// On two threads, each frame at its own time; late frames are dropped, and the mapper does
    /// what it can.
    Realtime,
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
    /// Frames dropped because they came too late.
    pub frames_dropped: usize,
    /// Frames that could not be read.
    pub frames_damaged: usize,
    /// Where the time went.
    pub timings: Timings,
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

/// Why a run ended early.
#[derive(Debug, thiserror::Error)]
pub enum SlamError {
    /// A setting is impossible.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The mapper failed.
    #[error("the mapper stopped: {0}")]
    Mapper(#[from] MapperError),
    /// The mapper panicked.
    #[error("the mapper stopped on an internal error")]
    MapperPanicked,
}

/// Runs the system over `frames`, all of the given camera, until they end or `stop` is set; either
/// way everything so far is returned. Frames that are errors are skipped and counted.
///
/// # Errors
/// If the configuration is impossible or the mapper fails.
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
    let tracker = Tracker::new(camera, config);
    let mapper = MapperWorker {
        mapper: Mapper::new(model, camera, config),
        budget: Budget::new(config.mapping.iterations_per_frame),
        busy: Duration::ZERO,
    };
    let mut front = Front {
        tracker,
        observer,
        stop,
        frames: Vec::new(),
        keyframes: Vec::new(),
        dropped: 0,
        damaged: 0,
    };
    let mut worker = match execution {
        Execution::Lockstep => lockstep(frames, &mut front, mapper)?,
        Execution::Parallel => parallel(frames, &mut front, mapper)?,
        Execution::Realtime => realtime(frames, &mut front, mapper)?,
    };
    worker.finish(front.finish().as_ref())?;
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
        gaussians: worker.mapper.gaussians(),
    })
}

/// The tracking side: the tracker and what it has found.
struct Front<'a> {
    tracker: Tracker,
    observer: &'a mut dyn Observer,
    stop: &'a AtomicBool,
    frames: Vec<Tracked>,
    keyframes: Vec<KeyframeRecord>,
    dropped: usize,
    damaged: usize,
}

impl Front<'_> {
    /// Tracks a frame; the keyframe it becomes, if any.
    fn track(&mut self, frame: RgbdFrame, map: &MapSize) -> Option<Keyframe> {
        let frame = Arc::new(frame);
        let (tracked, keyframe) = self.tracker.track(&frame);
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
    fn finish(&mut self) -> Option<Keyframe> {
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

    fn drop_late(&mut self) {
        self.dropped += 1;
        self.observer.on(&SlamEvent::Dropped);
    }
}

/// What the mapper tells observers of its progress.
#[derive(Default)]
struct MapSize {
    gaussians: AtomicUsize,
    steps: AtomicUsize,
}

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

/// The mapping side: the mapper and the time it used.
struct MapperWorker<M> {
    mapper: Mapper<M>,
    budget: Budget,
    busy: Duration,
}

impl<M: GaussianModel> MapperWorker<M> {
    /// Everything that is due after a frame.
    fn after_frame(
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
    fn finish(&mut self, keyframe: Option<&Keyframe>) -> Result<(), MapperError> {
        let start = Instant::now();
        if let Some(keyframe) = keyframe {
            self.mapper.insert(keyframe)?;
        }
        self.busy += start.elapsed();
        Ok(())
    }

    fn report(&mut self, start: Instant, map: &MapSize) -> SparseChanges {
        self.busy += start.elapsed();
        map.gaussians
            .store(self.mapper.num_gaussians(), Ordering::Relaxed);
        map.steps.store(self.mapper.steps(), Ordering::Relaxed);
        self.mapper.take_sparse_changes()
    }
}

fn lockstep<E: Error + 'static, M: GaussianModel>(
    frames: impl Iterator<Item = Result<RgbdFrame, E>>,
    front: &mut Front<'_>,
    mut worker: MapperWorker<M>,
) -> Result<MapperWorker<M>, SlamError> {
    let map = MapSize::default();
    let stop = front.stop;
    for frame in frames.take_while(|_| !stop.load(Ordering::Relaxed)) {
        match frame {
            Err(error) => front.skip(&error),
            Ok(frame) => {
                let keyframe = front.track(frame, &map);
                let changes = worker.after_frame(keyframe.as_ref(), &map)?;
                front.tracker.update_map(&changes);
            }
        }
    }
    Ok(worker)
}

fn parallel<E: Error + 'static, M: GaussianModel + Send>(
    frames: impl Iterator<Item = Result<RgbdFrame, E>>,
    front: &mut Front<'_>,
    mut worker: MapperWorker<M>,
) -> Result<MapperWorker<M>, SlamError> {
    // One message per frame: the channel's capacity is the number of frames the tracker may be
    // ahead, and sending blocks it when the mapper falls behind.
    let (to_mapper, from_tracker) = bounded::<Option<Keyframe>>(MAX_FRAMES_AHEAD);
    let (to_tracker, from_mapper) = unbounded::<SparseChanges>();
    let map = &MapSize::default();
    thread::scope(|scope| {
        let mapping = scope.spawn(move || {
            for keyframe in from_tracker {
                let changes = worker.after_frame(keyframe.as_ref(), map)?;
                if to_tracker.send(changes).is_err() {
                    break;
                }
            }
            Ok(worker)
        });
        let stop = front.stop;
        for frame in frames.take_while(|_| !stop.load(Ordering::Relaxed)) {
            match frame {
                Err(error) => front.skip(&error),
                Ok(frame) => {
                    from_mapper
                        .try_iter()
                        .for_each(|changes| front.tracker.update_map(&changes));
                    let keyframe = front.track(frame, map);
                    if to_mapper.send(keyframe).is_err() {
                        break;
                    }
                }
            }
        }
        drop(to_mapper);
        join(mapping)
    })
}

fn realtime<E: Error + 'static, M: GaussianModel + Send>(
    frames: impl Iterator<Item = Result<RgbdFrame, E>>,
    front: &mut Front<'_>,
    mut worker: MapperWorker<M>,
) -> Result<MapperWorker<M>, SlamError> {
    let (to_mapper, from_tracker) = unbounded::<Keyframe>();
    let (to_tracker, from_mapper) = unbounded::<SparseChanges>();
    let map = &MapSize::default();
    thread::scope(|scope| {
        let mapping = scope.spawn(move || {
            optimize_until_disconnected(&mut worker, &from_tracker, &to_tracker, map)?;
            Ok(worker)
        });
        let mut clock: Option<Clock> = None;
        let mut frames = frames.peekable();
        let stop = front.stop;
        while let Some(frame) = frames.next_if(|_| !stop.load(Ordering::Relaxed)) {
            let frame = match frame {
                Err(error) => {
                    front.skip(&error);
                    continue;
                }
                Ok(frame) => frame,
            };
            let clock = clock.get_or_insert_with(|| Clock::started_at(frame.timestamp_secs));
            // With its successor due already, a frame is late.
            let now = Instant::now();
            let late =
                matches!(frames.peek(), Some(Ok(next)) if clock.due(next.timestamp_secs) <= now);
            let until = if late {
                now
            } else {
                clock.due(frame.timestamp_secs)
            };
            if !follow_mapper_until(until, &mut front.tracker, &from_mapper) {
                break;
            }
            if late {
                front.drop_late();
                continue;
            }
            if let Some(keyframe) = front.track(frame, map)
                && to_mapper.send(keyframe).is_err()
            {
                break;
            }
        }
        drop(to_mapper);
        join(mapping)
    })
}

/// Takes over what the mapper reports until a time; `false` as soon as the mapper is gone.
fn follow_mapper_until(
    until: Instant,
    tracker: &mut Tracker,
    from_mapper: &Receiver<SparseChanges>,
) -> bool {
    loop {
        match from_mapper.recv_deadline(until) {
            Ok(changes) => tracker.update_map(&changes),
            Err(RecvTimeoutError::Timeout) => return true,
            Err(RecvTimeoutError::Disconnected) => return false,
        }
    }
}

/// Takes in keyframes as they come and optimises as long as the tracker lives.
fn optimize_until_disconnected<M: GaussianModel>(
    worker: &mut MapperWorker<M>,
    from_tracker: &Receiver<Keyframe>,
    to_tracker: &Sender<SparseChanges>,
    map: &MapSize,
) -> Result<(), MapperError> {
    let Ok(mut newest) = from_tracker.recv().map(Some) else {
        return Ok(());
    };
    loop {
        let start = Instant::now();
        match &newest {
            Some(keyframe) => worker.mapper.insert(keyframe)?,
            None => worker.mapper.step()?,
        }
        let changes = worker.report(start, map);
        if to_tracker.send(changes).is_err() {
            return Ok(());
        }
        newest = match from_tracker.try_recv() {
            Ok(keyframe) => Some(keyframe),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => return Ok(()),
        };
    }
}

fn join<M>(
    mapping: thread::ScopedJoinHandle<'_, Result<MapperWorker<M>, MapperError>>,
) -> Result<MapperWorker<M>, SlamError> {
    match mapping.join() {
        Ok(result) => Ok(result?),
        Err(_) => Err(SlamError::MapperPanicked),
    }
}

/// The recording's clock laid over the wall clock.
struct Clock {
    start: Instant,
    first_secs: f64,
}

impl Clock {
    fn started_at(first_secs: f64) -> Self {
        Self {
            start: Instant::now(),
            first_secs,
        }
    }

    /// When a frame is due. Nonsensical times are due at once.
    fn due(&self, timestamp_secs: f64) -> Instant {
        Duration::try_from_secs_f64(timestamp_secs - self.first_secs)
            .ok()
            .and_then(|after| self.start.checked_add(after))
            .unwrap_or(self.start)
    }
}
