//! Tracker and mapper side by side, computing on the same threads; the tracker waits when the mapper
//! falls behind, so that the map's quality does not depend on the machine.

use std::io;

use fgs_geom::Camera;

use super::mapping_thread::{MappingThread, Message, Policy, obey};
use super::worker::MapperWorker;
use crate::image_memory;

/// The tracker is at most so many frames ahead of the mapper: enough for both to keep busy across a
/// keyframe, few enough that the map it tracks against is fresh.
const MAX_FRAMES_AHEAD: usize = 10;

/// Starts the mapper's thread.
///
/// # Errors
/// If it does not start.
pub fn start(worker: MapperWorker, camera: &Camera) -> io::Result<MappingThread> {
    MappingThread::start(
        worker,
        Policy::EveryFrame,
        MAX_FRAMES_AHEAD.min(image_memory::waiting_frames(camera)),
        |worker, messages| {
            for message in messages {
                let steps = match message {
                    Message::Frame(_) => worker.steps_of_next_frame(),
                    _ => 0,
                };
                let alive = obey(worker, message) && worker.turn(|worker| worker.steps(steps));
                if !alive {
                    break;
                }
            }
        },
    )
}
