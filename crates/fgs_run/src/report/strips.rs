//! Bands over the frames of a run: verdicts, and keyframes by kind.

use std::io;
use std::ops::Range;

use fgs_slam::{FrameStatus, KeyframeKind};
use plotters::prelude::*;

use super::plot::{AXIS, LEFT, MARGIN, WIDTH, buckets, svg};
use super::run_data::RunData;
use crate::frame_log::FrameRow;

const HEIGHT: u32 = 20;
/// Share of the width: a single frame of a long run is still seen.
const MIN_BAND: f64 = 0.0015;

/// Verdicts with their colours, the worst last: where several frames share a pixel, it is shown.
pub const VERDICTS: [(FrameStatus, RGBColor); 5] = [
    (FrameStatus::Tracked, RGBColor(140, 195, 140)),
    (FrameStatus::Weak, RGBColor(240, 170, 50)),
    (FrameStatus::Dropped, RGBColor(150, 150, 150)),
    (FrameStatus::Damaged, RGBColor(130, 70, 160)),
    (FrameStatus::Lost, RGBColor(208, 48, 48)),
];

pub const KEYFRAMES: [(KeyframeKind, RGBColor); 2] = [
    (KeyframeKind::Tracking, RGBColor(30, 80, 160)),
    (KeyframeKind::Mapping, RGBColor(90, 160, 210)),
];

/// Which frames of a run were tracked, weak, lost, ...
///
/// # Errors
/// If drawing fails.
pub fn verdict_strip(run: &RunData, frames: Range<f64>) -> io::Result<String> {
    strip(run, frames, |rows| {
        let mut verdicts = VERDICTS.iter().rev();
        let worst = verdicts.find(|(status, _)| rows.iter().any(|row| row.status == *status));
        worst.map(|(_, color)| *color)
    })
}

/// Which frames of a run became keyframes of a kind.
///
/// # Errors
/// If drawing fails.
pub fn keyframe_strip(
    run: &RunData,
    frames: Range<f64>,
    kind: KeyframeKind,
    color: RGBColor,
) -> io::Result<String> {
    strip(run, frames, |rows| {
        let is_one = rows.iter().any(|row| row.keyframe == Some(kind));
        is_one.then_some(color)
    })
}

fn strip(
    run: &RunData,
    frames: Range<f64>,
    color: impl Fn(&[FrameRow]) -> Option<RGBColor>,
) -> io::Result<String> {
    let mut bands: Vec<(Range<f64>, RGBColor)> = Vec::new();
    for places in buckets(run.rows.len()) {
        let rows = &run.rows[places];
        let (Some(color), [first, .., last] | [first @ last]) = (color(rows), rows) else {
            continue;
        };
        let band = first.index as f64..last.index as f64 + 1.0;
        match bands.last_mut() {
            Some((last, same)) if *same == color && last.end == band.start => last.end = band.end,
            _ => bands.push((band, color)),
        }
    }
    let min_width = MIN_BAND * (frames.end - frames.start);
    let frame = [(frames.start, 0.0), (frames.end, 1.0)];
    svg((WIDTH, HEIGHT), |area| {
        let mut chart = ChartBuilder::on(area)
            .margin_left(MARGIN + LEFT)
            .margin_right(MARGIN)
            .build_cartesian_2d(frames, 0.0..1.0)?;
        chart.draw_series(bands.iter().map(|(band, color)| {
            let end = band.end.max(band.start + min_width);
            Rectangle::new([(band.start, 0.0), (end, 1.0)], color.filled())
        }))?;
        chart.draw_series([Rectangle::new(frame, AXIS)])?;
        Ok(())
    })
}
