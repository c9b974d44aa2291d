//! The mapper beside a live camera: it optimises all the while, and the tracker never waits for it.
//! A keyframe for which it has no room is put off.
//!
//! Tracker and mapper compute on threads of their own: in a common pool each of the tracker's short
//! loops would wait for the mapper's long ones, whereas the operating system lets it in at once.

use std::io;

use crossbeam_channel::{Receiver, TryRecvError};
use fgs_geom::Camera;
use rayon::{ThreadPool, ThreadPoolBuilder};

use super::mapping_thread::{MappingThread, Message, Policy, obey};
use super::worker::MapperWorker;
use crate::image_memory;

/// So many keyframes may wait for the mapper: a camera that turns into new ground makes a few in a
/// row, and each holds its images in memory.
const MAX_KEYFRAMES_WAITING: usize = 8;

/// The tracker's share of the threads: its work is a fraction of the mapper's.
const TRACKER_SHARE: usize = 4;

/// Starts the mapper's thread, with a pool of its own.
///
/// # Errors
/// If a thread does not start.
pub fn start(worker: MapperWorker, camera: &Camera) -> io::Result<MappingThread> {
    let pool = pool("mapper", rayon::current_num_threads())?;
    MappingThread::start(
        worker,
        Policy::KeyframesWhileRoom,
        MAX_KEYFRAMES_WAITING.min(image_memory::waiting_frames(camera)),
        move |worker, messages| pool.install(|| optimize_all_the_while(worker, messages)),
    )
}

/// Threads that compute for the tracker alone.
///
/// # Errors
/// If they do not start.
pub fn tracker_pool() -> io::Result<ThreadPool> {
    pool(
        "tracker",
        (rayon::current_num_threads() / TRACKER_SHARE).max(1),
    )
}

fn pool(name: &'static str, threads: usize) -> io::Result<ThreadPool> {
    ThreadPoolBuilder::new()
        .num_threads(threads)
        .thread_name(move |i| format!("{name} {i}"))
        .build()
        .map_err(io::Error::other)
}

fn optimize_all_the_while(worker: &mut MapperWorker, messages: &Receiver<Message>) {
    loop {
        let message = if worker.is_preparing() {
            // The next one must wait for this anyway.
            Err(TryRecvError::Empty)
        } else if worker.can_optimize() {
            messages.try_recv()
        } else {
            messages.recv().map_err(|_| TryRecvError::Disconnected)
        };
        let alive = match message {
            Ok(message) => obey(worker, message),
            Err(TryRecvError::Empty) => worker.turn(|worker| worker.steps(1)),
            Err(TryRecvError::Disconnected) => return,
        };
        if !alive {
            return;
        }
    }
}
