//! Feeds the frames of a live camera: a source that blocks until the next one comes.
//!
//! The source has a thread of its own, so that a stop request is seen while it blocks. Frames wait
//! in a short queue; what has waited too long is dropped, and so is what finds the queue full.

use std::error::Error;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::Builder;
use std::time::Instant;

use crossbeam_channel::{RecvTimeoutError, TrySendError, bounded};
use fgs_geom::RgbdFrame;

use super::drive::{push, until_stopped};
use super::replay::{GLANCE, MAX_WAIT};
use crate::session::Slam;

/// Frames that may wait for the tracker: what a camera at 60 Hz delivers while one may wait.
const QUEUE: usize = 6;

/// Pushes what `source` delivers until it ends (`None`), `stop` is set or the mapper is gone.
/// Frames that the tracker is too slow for are recorded as dropped. Frames are numbered here, in the order
/// in which they are recorded.
///
/// The source runs on a thread of its own, which ends when the source next returns.
///
/// # Errors
/// If that thread does not start.
pub fn live<E: Error + Send + 'static>(
    slam: &mut Slam,
    source: impl FnMut() -> Option<Result<RgbdFrame, E>> + Send + 'static,
    stop: &AtomicBool,
) -> io::Result<()> {
    live_with(slam, source, stop, |_| {})
}

/// As [`live`], and calls `after_frame` after each frame.
///
/// # Errors
/// Those of [`live`].
pub fn live_with<E: Error + Send + 'static>(
    slam: &mut Slam,
    mut source: impl FnMut() -> Option<Result<RgbdFrame, E>> + Send + 'static,
    stop: &AtomicBool,
    mut after_frame: impl FnMut(&mut Slam),
) -> io::Result<()> {
    let (to_tracker, frames) = bounded(QUEUE);
    let overflowed = Arc::new(AtomicUsize::new(0));
    let overflow = Arc::clone(&overflowed);
    Builder::new().name("camera".into()).spawn(move || {
        while let Some(frame) = source() {
            match to_tracker.try_send((frame, Instant::now())) {
                Ok(()) => {}
                Err(TrySendError::Full(_)) => {
                    overflow.fetch_add(1, Ordering::Relaxed);
                }
                Err(TrySendError::Disconnected(_)) => return,
            }
        }
    })?;
    until_stopped(slam, stop, |slam| {
        let mut alive = true;
        while alive && !stop.load(Ordering::Relaxed) {
            let message = frames.recv_timeout(GLANCE);
            for _ in 0..overflowed.swap(0, Ordering::Relaxed) {
                slam.skip_overflowed();
            }
            alive = match message {
                Ok((frame, came)) => {
                    let frame = frame.map(|mut frame| {
                        frame.index = slam.next_index();
                        frame
                    });
                    match frame {
                        Ok(frame) if came.elapsed() > MAX_WAIT => {
                            slam.skip_late(&frame);
                            true
                        }
                        frame => {
                            let alive = push(slam, frame);
                            after_frame(slam);
                            alive
                        }
                    }
                }
                Err(RecvTimeoutError::Timeout) => slam.wait_until(Instant::now()),
                Err(RecvTimeoutError::Disconnected) => false,
            };
        }
    });
    Ok(())
}
