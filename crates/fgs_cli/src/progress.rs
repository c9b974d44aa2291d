//! Follows a run: keeps a row of each frame, moves the progress bar, warns of damaged frames.

use std::ops::Range;

use fgs_slam::{Observer, SlamEvent, Tracked, TrackingStatus};
use indicatif::ProgressBar;
use serde_json::json;

use crate::console::{Console, Warnings};
use crate::frame_log::{FrameRow, FrameStatus};

/// Sees every event of a run. Each frame gives exactly one, in order.
pub struct RunObserver {
    console: Console,
    bar: ProgressBar,
    damaged: Warnings,
    next_index: usize,
    keyframes: usize,
    rows: Vec<FrameRow>,
}

impl RunObserver {
    /// For a run over these frames of a recording.
    pub fn new(frames: &Range<usize>, console: Console) -> Self {
        Self {
            console,
            bar: console.progress(frames.len(), "frames"),
            damaged: Warnings::default(),
            next_index: frames.start,
            keyframes: 0,
            rows: Vec::with_capacity(frames.len()),
        }
    }

    /// The rows of all frames seen, at the end.
    pub fn into_rows(self) -> Vec<FrameRow> {
        self.bar.finish_and_clear();
        self.rows
    }
}

impl Observer for RunObserver {
    fn on(&mut self, event: &SlamEvent<'_>) {
        let index = self.next_index;
        self.next_index += 1;
        let row = match event {
            SlamEvent::Frame {
                tracked,
                keyframe,
                num_gaussians,
                steps,
            } => {
                self.keyframes += usize::from(keyframe.is_some());
                let message = format!("{} keyframes, {num_gaussians} gaussians", self.keyframes);
                self.bar.set_message(message);
                let mut row = row_of(tracked);
                row.keyframe = keyframe.map(Into::into);
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
                row
            }
            SlamEvent::Damaged { error } => {
                self.damaged
                    .warn(&self.bar, format!("frame {index} is skipped: {error}"));
                let message = error.to_string();
                self.console
                    .event("damaged", json!({ "index": index, "message": message }));
                FrameRow::without_result(index, FrameStatus::Damaged)
            }
            SlamEvent::Dropped => {
                self.console.event("dropped", json!({ "index": index }));
                FrameRow::without_result(index, FrameStatus::Dropped)
            }
        };
        self.rows.push(row);
        self.bar.inc(1);
    }
}

fn row_of(tracked: &Tracked) -> FrameRow {
    let status = match tracked.status {
        TrackingStatus::Tracked => FrameStatus::Tracked,
        TrackingStatus::Lost => FrameStatus::Lost,
    };
    FrameRow {
        timestamp_secs: Some(tracked.timestamp_secs),
        points: Some(tracked.points),
        sparse_points: Some(tracked.sparse_points),
        inliers: Some(tracked.inliers),
        residual_m: Some(tracked.residual_m),
        conditioning: Some(tracked.conditioning),
        tracking_ms: Some(1e3 * tracked.duration.as_secs_f64()),
        ..FrameRow::without_result(tracked.index.0, status)
    }
}
