//! Lines over frames, as SVG. Nothing but numbers stands in a plot; names stand in the page around it.

use std::io;
use std::ops::Range;

use plotters::coord::Shift;
use plotters::prelude::*;

use super::run_data::RunData;

/// Pixels. Every plot over frames is as wide, so that they can be compared from top to bottom.
pub const WIDTH: u32 = 960;
const HEIGHT: u32 = 150;
/// Room for the numbers beside an axis.
pub const LEFT: u32 = 64;
pub const BELOW: u32 = 24;
pub const MARGIN: u32 = 8;
pub const FONT: (&str, u32) = ("sans-serif", 12);
pub const GRID: RGBColor = RGBColor(225, 225, 225);
pub const AXIS: RGBColor = RGBColor(120, 120, 120);

/// More points than pixels show nothing more.
const MAX_BUCKETS: usize = 1000;
/// Larger numbers come from damaged files, and would leave no digits for the axes.
const MAX_SHOWN: f64 = 1e9;

pub type PlotError = DrawingAreaErrorKind<io::Error>;
pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Points that are connected; where there is a gap, another begins.
pub type Stretch = Vec<(f64, f64)>;

/// What one run has in a plot.
pub struct Line {
    pub color: RGBColor,
    pub stretches: Vec<Stretch>,
}

/// Draws into an SVG of a size in pixels.
pub fn svg(
    size: (u32, u32),
    draw: impl FnOnce(&Area<'_>) -> Result<(), PlotError>,
) -> io::Result<String> {
    let mut text = String::new();
    let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
    draw(&area)
        .and_then(|()| area.present())
        .map_err(io::Error::other)?;
    drop(area);
    Ok(text)
}

/// The frames of runs: the axis of every plot over frames.
pub fn frame_range<'a>(runs: impl IntoIterator<Item = &'a RunData>) -> Range<f64> {
    let indices = runs.into_iter().flat_map(|run| &run.rows);
    let indices = indices.map(|row| row.index as f64);
    let (low, high) = bounds(indices).unwrap_or((0.0, 0.0));
    low..high + 1.0
}

/// Lines over frames.
///
/// # Errors
/// If drawing fails.
pub fn line_plot(lines: &[Line], frames: Range<f64>, from_zero: bool) -> io::Result<String> {
    let points = lines
        .iter()
        .flat_map(|line| line.stretches.iter().flatten());
    let (low, high) = bounds(points.map(|point| point.1)).unwrap_or((0.0, 1.0));
    let low = if from_zero { low.min(0.0) } else { low };
    // A constant needs an axis too.
    let room = match (high - low, high.abs()) {
        (0.0, 0.0) => 1.0,
        (0.0, constant) => 0.1 * constant,
        (extent, _) => 0.05 * extent,
    };
    let values = if low == 0.0 { 0.0 } else { low - room }..high + room;
    svg((WIDTH, HEIGHT), |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(MARGIN)
            .x_label_area_size(BELOW)
            .y_label_area_size(LEFT)
            .build_cartesian_2d(frames, values)?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(GRID)
            .axis_style(AXIS)
            .label_style(FONT)
            .x_labels(12)
            .y_labels(5)
            .x_label_formatter(&whole)
            .draw()?;
        for line in lines {
            for stretch in &line.stretches {
                let points = stretch.iter().copied();
                chart.draw_series(LineSeries::new(points.clone(), line.color))?;
                // A frame between gaps has no line.
                let alone = points.filter(|_| stretch.len() == 1);
                let dots = alone.map(|point| Circle::new(point, 1, line.color.filled()));
                chart.draw_series(dots)?;
            }
        }
        Ok(())
    })
}

/// There are no frames between frames.
fn whole(frame: &f64) -> String {
    if frame.fract() == 0.0 {
        format!("{frame:.0}")
    } else {
        String::new()
    }
}

/// The smallest and the largest number that can be shown; `None` of nothing.
pub fn bounds(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let shown = values.filter(|value| value.abs() <= MAX_SHOWN);
    shown.fold(None, |bounds, value| {
        let (low, high) = bounds.unwrap_or((value, value));
        Some((value.min(low), value.max(high)))
    })
}

/// Values of a run's frames as lines with gaps where there are none. In long runs the smallest and the
/// largest of neighbouring frames stand for all of them, so that no outlier is lost.
pub fn stretches(run: &RunData, value: impl Fn(&RunData, usize) -> Option<f64>) -> Vec<Stretch> {
    let point = |place: usize| {
        let value = value(run, place).filter(|value| value.abs() <= MAX_SHOWN)?;
        Some((run.rows[place].index as f64, value))
    };
    let mut stretches = vec![Stretch::new()];
    for places in buckets(run.rows.len()) {
        let points: Vec<_> = places.filter_map(point).collect();
        let by_value = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
        let low = points.iter().min_by(by_value);
        let (Some(&low), Some(&high)) = (low, points.iter().max_by(by_value)) else {
            stretches.push(Stretch::new());
            continue;
        };
        let (first, second) = if low.0 <= high.0 {
            (low, high)
        } else {
            (high, low)
        };
        if let Some(stretch) = stretches.last_mut() {
            stretch.push(first);
            if second.0 > first.0 {
                stretch.push(second);
            }
        }
    }
    stretches.retain(|stretch| !stretch.is_empty());
    stretches
}

/// Groups of successive places that are shown as one.
pub fn buckets(len: usize) -> impl Iterator<Item = Range<usize>> {
    let step = len.div_ceil(MAX_BUCKETS).max(1);
    (0..len)
        .step_by(step)
        .map(move |start| start..(start + step).min(len))
}
