//! Shows a run on its way: moves the progress bars, warns of damaged frames, writes events.

use fgs_run::{FrameRow, RunEvent, RunObserver};
use fgs_slam::FrameStatus;
use indicatif::ProgressBar;
use serde_json::json;

use crate::console::{Console, Warnings};

/// What the bar counts, in turn.
const FRAMES: &str = "frames";
const REFINEMENT: &str = "refinement";
const EVALUATION: &str = "evaluation";

/// Sees every event of a run.
pub struct Progress {
    console: Console,
    bar: ProgressBar,
    /// What the bar counts now.
    phase: &'static str,
    damaged: Warnings,
    keyframes: usize,
}

impl Progress {
    /// Of a run over so many frames, if their number is known.
    pub fn new(frames: Option<usize>, console: Console) -> Self {
        Self {
            console,
            bar: console.progress(frames, FRAMES),
            phase: FRAMES,
            damaged: Warnings::default(),
            keyframes: 0,
        }
    }

    fn frame(&mut self, row: &FrameRow, error: Option<&str>, num_gaussians: usize, steps: usize) {
        let index = row.index;
        match row.status {
            FrameStatus::Damaged => {
                let error = error.unwrap_or("damaged");
                self.damaged
                    .warn(&self.bar, format!("frame {index} is skipped: {error}"));
                self.console
                    .event("damaged", json!({ "index": index, "message": error }));
            }
            FrameStatus::Dropped => self.console.event("dropped", json!({ "index": index })),
            _ => {
                self.keyframes += usize::from(row.keyframe.is_some());
                let message = format!("{} keyframes, {num_gaussians} gaussians", self.keyframes);
                self.bar.set_message(message);
                self.console.event(
                    "frame",
                    json!({
                        "index": index,
                        "timestamp_secs": row.timestamp_secs,
                        "status": row.status,
                        "keyframe": row.keyframe,
                        "inliers": row.inliers,
                        "tracking_ms": row.tracking_ms,
                        "num_gaussians": num_gaussians,
                        "iterations": steps,
                    }),
                );
            }
        }
    }

    /// Moves the bar of a phase, in place of the last one's.
    fn advance(&mut self, phase: &'static str, done: usize, total: usize) {
        if self.phase != phase {
            self.phase = phase;
            self.bar.finish_and_clear();
            self.bar = self.console.progress(total, phase);
        }
        self.bar.set_position(done as u64);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

impl RunObserver for Progress {
    fn on(&mut self, event: &RunEvent<'_>) {
        match event {
            RunEvent::Frame {
                row,
                error,
                num_gaussians,
                steps,
            } => {
                self.frame(row, *error, *num_gaussians, *steps);
                self.bar.inc(1);
            }
            RunEvent::Refined { done, total } => {
                if self.phase != REFINEMENT {
                    self.console.event(REFINEMENT, json!({ "steps": total }));
                }
                self.advance(REFINEMENT, *done, *total);
            }
            RunEvent::Scored { done, total } => self.advance(EVALUATION, *done, *total),
            _ => {}
        }
    }
}
