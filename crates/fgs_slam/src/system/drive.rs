//! Feeds frames as fast as the session takes them.

use std::error::Error;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use crossbeam_channel::{RecvTimeoutError, bounded};
use fgs_geom::RgbdFrame;

use super::replay::GLANCE;
use crate::session::{Slam, SlamError};

/// Pushes each frame until they end, `stop` is set or the mapper is gone. Frames that are errors, or
/// that the session refuses, are recorded as damaged, and the run goes on.
pub fn drive<E: Error>(
    slam: &mut Slam,
    frames: impl Iterator<Item = Result<RgbdFrame, E>>,
    stop: &AtomicBool,
) {
    drive_with(slam, frames, stop, |_| {});
}

/// As [`drive`], and calls `after_frame` after each frame.
pub fn drive_with<E: Error>(
    slam: &mut Slam,
    frames: impl Iterator<Item = Result<RgbdFrame, E>>,
    stop: &AtomicBool,
    mut after_frame: impl FnMut(&mut Slam),
) {
    until_stopped(slam, stop, |slam| {
        for frame in frames.take_while(|_| !stop.load(Ordering::Relaxed)) {
            let alive = push(slam, frame);
            after_frame(slam);
            if !alive {
                break;
            }
        }
    });
}

/// Does `work`, and lets the mapper take no further step once `stop` is set: a frame's steps may take
/// minutes.
pub fn until_stopped(slam: &mut Slam, stop: &AtomicBool, work: impl FnOnce(&mut Slam)) {
    let map = slam.map_status();
    thread::scope(|scope| {
        let (working, done) = bounded::<()>(0);
        scope.spawn(move || {
            while let Err(RecvTimeoutError::Timeout) = done.recv_timeout(GLANCE) {
                if stop.load(Ordering::Relaxed) {
                    return map.stop_optimizing();
                }
            }
        });
        work(slam);
        drop(working);
    });
    if stop.load(Ordering::Relaxed) {
        slam.map_status().stop_optimizing();
    }
}

/// Pushes what came in place of a frame; `false` once the mapper is gone.
pub fn push<E: Error>(slam: &mut Slam, frame: Result<RgbdFrame, E>) -> bool {
    match frame {
        Ok(frame) => !matches!(slam.push(frame), Err(SlamError::MapperStopped)),
        Err(error) => {
            slam.skip_damaged(&error.to_string());
            true
        }
    }
}
