//! Trajectories seen from above and from the side, as SVG, the same metre in both directions.

use std::io;
use std::ops::Range;

use fgs_slam::FrameStatus;
use plotters::prelude::*;

use super::plot::{AXIS, BELOW, FONT, GRID, LEFT, MARGIN, bounds, svg};
use super::run_data::{Position, RunData};
use crate::frame_log::FrameRow;

/// Pixels.
const SIZE: (u32, u32) = (472, 400);
/// More places than this show nothing more.
const MAX_PLACES: usize = 2000;
/// A camera that stands still is not shown larger than this, metres.
const MIN_EXTENT_M: f64 = 0.1;

/// A direction to look in.
pub struct View {
    pub name: &'static str,
    /// What the axes show, to the right and upwards.
    pub axes: [&'static str; 2],
    place: fn(&Position) -> (f64, f64),
}

/// The first camera looks upwards in the first and to the right in the second.
pub const VIEWS: [View; 2] = [
    View {
        name: "from above",
        axes: ["x", "z"],
        place: |[x, _, z]| (*x, *z),
    },
    View {
        name: "from the side",
        axes: ["z", "−y"],
        place: |[_, y, z]| (*z, -*y),
    },
];

/// Places that are connected, or marked each by itself.
pub struct Path {
    pub color: RGBColor,
    pub width: u32,
    pub places: Vec<Position>,
}

/// What is shown, from below to above.
#[derive(Default)]
pub struct Scene {
    pub paths: Vec<Path>,
    pub marks: Vec<Path>,
}

impl Scene {
    /// Adds connected places; of successive ones with the same colour one path is made.
    pub fn add_path(&mut self, places: &[Position], width: u32, color: impl Fn(usize) -> RGBColor) {
        let mut paths: Vec<Path> = Vec::new();
        for end in 1..places.len() {
            let color = color(end);
            match paths.last_mut() {
                Some(path) if path.color == color => path.places.push(places[end]),
                _ => paths.push(Path {
                    color,
                    width,
                    places: vec![places[end - 1], places[end]],
                }),
            }
        }
        self.paths.append(&mut paths);
    }

    /// Adds connected places, of many only some.
    pub fn add_thinned(&mut self, places: &[Position], width: u32, color: RGBColor) {
        let step = places.len().div_ceil(MAX_PLACES).max(1);
        let places: Vec<_> = places.iter().step_by(step).copied().collect();
        self.add_path(&places, width, |_| color);
    }

    /// Draws it.
    ///
    /// # Errors
    /// If drawing fails.
    pub fn draw(&self, view: &View) -> io::Result<String> {
        let shown = self.paths.iter().chain(&self.marks);
        let shown: Vec<_> = shown
            .flat_map(|path| &path.places)
            .map(view.place)
            .collect();
        let width = f64::from(SIZE.0 - 2 * MARGIN - LEFT);
        let height = f64::from(SIZE.1 - 2 * MARGIN - BELOW);
        let (middle_x, extent_x) = extent(shown.iter().map(|place| place.0));
        let (middle_y, extent_y) = extent(shown.iter().map(|place| place.1));
        let metres_per_px = (extent_x / width).max(extent_y / height);
        let range = |middle: f64, pixels: f64| -> Range<f64> {
            let half = 0.5 * pixels * metres_per_px;
            middle - half..middle + half
        };
        svg(SIZE, |area| {
            let mut chart = ChartBuilder::on(area)
                .margin(MARGIN)
                .x_label_area_size(BELOW)
                .y_label_area_size(LEFT)
                .build_cartesian_2d(range(middle_x, width), range(middle_y, height))?;
            chart
                .configure_mesh()
                .light_line_style(TRANSPARENT)
                .bold_line_style(GRID)
                .axis_style(AXIS)
                .label_style(FONT)
                .x_labels(6)
                .y_labels(6)
                .draw()?;
            for path in &self.paths {
                let places = path.places.iter().map(view.place);
                chart.draw_series(LineSeries::new(places, path.color.stroke_width(path.width)))?;
            }
            for path in &self.marks {
                let places = path.places.iter().map(view.place);
                let circles = places.map(|place| Circle::new(place, path.width, path.color));
                chart.draw_series(circles)?;
            }
            Ok(())
        })
    }
}

/// The middle of numbers, and the length that holds them with room around.
fn extent(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = bounds(values).unwrap_or((0.0, 0.0));
    (0.5 * (low + high), 1.1 * (high - low).max(MIN_EXTENT_M))
}

/// Successive places of frames in which the frame has one, as positions in `places`. Of long ones only
/// some, but always both ends.
pub fn unbroken(run: &RunData, places: &[Option<Position>]) -> Vec<Vec<usize>> {
    let mut paths: Vec<Vec<usize>> = Vec::new();
    let mut last = None;
    for place in (0..places.len()).filter(|place| places[*place].is_some()) {
        // A frame that came late or could not be read is no loss.
        let is_lost = |row: &FrameRow| row.status == FrameStatus::Lost;
        let broken = last.is_none_or(|last: usize| run.rows[last..place].iter().any(is_lost));
        match paths.last_mut() {
            Some(path) if !broken => path.push(place),
            _ => paths.push(vec![place]),
        }
        last = Some(place);
    }
    let step = places.len().div_ceil(MAX_PLACES).max(1);
    for path in &mut paths {
        let end = path.len() - 1;
        let mut count = 0..=end;
        path.retain(|_| count.next().is_some_and(|i| i % step == 0 || i == end));
    }
    paths
}
