//! Feeds frames as fast as the session takes them.

use std::error::Error;
use std::sync::atomic::{AtomicBool, Ordering};

use fgs_geom::RgbdFrame;

use crate::session::{Slam, SlamError};

/// Pushes each frame until they end, `stop` is set or the mapper is gone. Frames that are errors, or
/// that the session refuses, are recorded as damaged, and the run goes on.
pub fn drive<E: Error>(
    slam: &mut Slam,
    frames: impl Iterator<Item = Result<RgbdFrame, E>>,
    stop: &AtomicBool,
) {
    for frame in frames.take_while(|_| !stop.load(Ordering::Relaxed)) {
        if !push(slam, frame) {
            break;
        }
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
