//! Tracker and mapper side by side, each frame at its own time, as from a live camera.
//!
//! A frame that finds the tracker busy waits; only one that has waited too long is dropped, since
//! every frame left out makes the next motion larger and tracking less safe. The mapper optimises
//! all the while. Each computes on threads of its own: in a common pool each of the tracker's short
//! loops would wait for the mapper's long ones, whereas the operating system lets it in at once.

use std::error::Error;
use std::thread;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TryRecvError, unbounded};
use fgs_geom::RgbdFrame;
use fgs_splat::{GaussianModel, SparseId};
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};

use super::SlamError;
use super::front::{Front, MapSize};
use super::worker::{MapperWorker, join};
use crate::keyframes::Keyframe;
use crate::tracker::Tracker;

/// How long a frame may wait for the tracker: three frames at 30 a second, enough to make up for a
/// moment's delay, and less than people notice as lag.
const MAX_WAIT: Duration = Duration::from_millis(100);

pub fn run<E: Error + 'static, M: GaussianModel>(
    frames: impl Iterator<Item = Result<RgbdFrame, E>>,
    front: &mut Front<'_>,
    mut worker: MapperWorker<M>,
) -> Result<MapperWorker<M>, SlamError> {
    front.compute_on(pool("tracker", tracker_threads())?);
    let mapper_pool = pool("mapper", rayon::current_num_threads())?;
    let (to_mapper, from_tracker) = unbounded::<Keyframe>();
    let (to_tracker, from_mapper) = unbounded::<Vec<SparseId>>();
    let map = &MapSize::default();
    thread::scope(|scope| {
        let mapping = scope.spawn(move || {
            mapper_pool.install(|| {
                optimize_until_disconnected(&mut worker, &from_tracker, &to_tracker, map);
            });
            worker
        });
        let mut clock: Option<Clock> = None;
        front.follow(frames, |front, frame| {
            let clock = clock.get_or_insert_with(|| Clock::started_at(frame.timestamp_secs));
            let due = clock.due(frame.timestamp_secs);
            follow_mapper_until(due, &mut front.tracker, &from_mapper)?;
            if Instant::now() > due + MAX_WAIT {
                front.drop_late();
            } else if let Some(keyframe) = front.track(frame, map) {
                to_mapper.send(keyframe).ok()?;
            }
            Some(())
        });
        drop(to_mapper);
        join(mapping)
    })
}

/// Threads that compute for the tracker alone: its work is a fraction of the mapper's.
fn tracker_threads() -> usize {
    /// The tracker's share of the threads.
    const SHARE: usize = 4;
    (rayon::current_num_threads() / SHARE).max(1)
}

fn pool(name: &'static str, threads: usize) -> Result<ThreadPool, ThreadPoolBuildError> {
    ThreadPoolBuilder::new()
        .num_threads(threads)
        .thread_name(move |i| format!("{name} {i}"))
        .build()
}

/// Takes over what the mapper reports until a time; `None` as soon as the mapper is gone.
fn follow_mapper_until(
    until: Instant,
    tracker: &mut Tracker,
    from_mapper: &Receiver<Vec<SparseId>>,
) -> Option<()> {
    loop {
        match from_mapper.recv_deadline(until) {
            Ok(changes) => tracker.update_map(&changes),
            Err(RecvTimeoutError::Timeout) => return Some(()),
            Err(RecvTimeoutError::Disconnected) => return None,
        }
    }
}

/// Takes in keyframes as they come and optimises as long as the tracker lives and nothing fails.
fn optimize_until_disconnected<M: GaussianModel>(
    worker: &mut MapperWorker<M>,
    from_tracker: &Receiver<Keyframe>,
    to_tracker: &Sender<Vec<SparseId>>,
    map: &MapSize,
) {
    let Ok(mut newest) = from_tracker.recv().map(Some) else {
        return;
    };
    while let Some(changes) = worker.work(map, |mapper| match &newest {
        Some(keyframe) => mapper.insert(keyframe),
        None => mapper.step(),
    }) {
        if to_tracker.send(changes).is_err() {
            return;
        }
        newest = match from_tracker.try_recv() {
            Ok(keyframe) => Some(keyframe),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => return,
        };
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
