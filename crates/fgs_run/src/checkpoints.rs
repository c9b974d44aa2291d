//! When a run's map is written: every so many seconds, between two frames, and when the frames have ended.
//!
//! A map that cannot be written ends the checkpoints, not the run: what was complete before stays, and the
//! error is returned with the results.

use std::time::{Duration, Instant};

use fgs_slam::{Slam, SlamError};

use crate::error::RunError;
use crate::map_folder::MapWriter;

/// Writes the map of a session as it grows.
pub struct Checkpoints {
    every: Duration,
    last: Instant,
    writer: MapWriter,
    failure: Option<RunError>,
}

impl Checkpoints {
    /// Checkpoints of a session that has just begun.
    pub fn begin(every: Duration, writer: MapWriter, slam: &mut Slam) -> Self {
        slam.keep_new_keyframes();
        Self {
            every,
            last: Instant::now(),
            writer,
            failure: None,
        }
    }

    /// Writes new keyframes, and the rest if it is time.
    pub fn after_frame(&mut self, slam: &mut Slam) {
        let is_due = self.last.elapsed() >= self.every;
        let new_keyframes = slam.take_new_keyframes();
        self.attempt(|writer| {
            for (id, frame) in &new_keyframes {
                writer.add_keyframe(*id, frame)?;
            }
            if is_due {
                complete(writer, slam)?;
            }
            Ok(())
        });
        if is_due {
            self.last = Instant::now();
        }
    }

    /// Writes the state in which the frames have ended; returns what went wrong, now or before.
    pub fn finish(mut self, slam: &mut Slam) -> Result<(), RunError> {
        self.every = Duration::ZERO;
        self.after_frame(slam);
        self.failure.map_or(Ok(()), Err)
    }

    fn attempt(&mut self, write: impl FnOnce(&mut MapWriter) -> Result<(), RunError>) {
        if self.failure.is_none() {
            self.failure = write(&mut self.writer).err();
        }
    }
}

/// A session whose mapper has stopped cannot be gone on with: the checkpoint before stays.
fn complete(writer: &mut MapWriter, slam: &mut Slam) -> Result<(), RunError> {
    match slam.save() {
        Ok(session) => writer.complete(&session),
        Err(SlamError::MapperStopped) => Ok(()),
        Err(error) => Err(error.into()),
    }
}
