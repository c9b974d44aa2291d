//! Tracker and mapper side by side, computing on the same threads; the tracker waits when the mapper
//! falls behind.

use std::error::Error;
use std::thread;

use crossbeam_channel::{bounded, unbounded};
use fgs_geom::RgbdFrame;
use fgs_splat::{GaussianModel, SparseId};

use super::SlamError;
use super::front::{Front, MapSize};
use super::worker::{MapperWorker, join};
use crate::keyframes::Keyframe;

/// The tracker is at most so many frames ahead of the mapper: enough for both to keep busy across a
/// keyframe, few enough that the map it tracks against is fresh.
const MAX_FRAMES_AHEAD: usize = 10;

pub fn run<E: Error + 'static, M: GaussianModel>(
    frames: impl Iterator<Item = Result<RgbdFrame, E>>,
    front: &mut Front<'_>,
    mut worker: MapperWorker<M>,
) -> Result<MapperWorker<M>, SlamError> {
    // One message per frame: the channel's capacity is the number of frames the tracker may be
    // ahead, and sending blocks it when the mapper falls behind.
    let (to_mapper, from_tracker) = bounded::<Option<Keyframe>>(MAX_FRAMES_AHEAD);
    let (to_tracker, from_mapper) = unbounded::<Vec<SparseId>>();
    let map = &MapSize::default();
    thread::scope(|scope| {
        let mapping = scope.spawn(move || {
            for keyframe in from_tracker {
                let changes = worker.after_frame(keyframe.as_ref(), map);
                if changes.is_none_or(|changes| to_tracker.send(changes).is_err()) {
                    break;
                }
            }
            worker
        });
        front.follow(frames, |front, frame| {
            from_mapper
                .try_iter()
                .for_each(|changes| front.tracker.update_map(&changes));
            to_mapper.send(front.track(frame, map)).ok()
        });
        drop(to_mapper);
        join(mapping)
    })
}
