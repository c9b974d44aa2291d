//! A camera changes its exposure and white balance as it likes; a map has one of each. A keyframe's
//! measured colours are brought to the map's by a gain and an offset for each channel.

use fgs_geom::Image;
use nalgebra::{Matrix2, Vector2};

use crate::{Rendered, Target};

/// Colours are compared as means over cells of so many pixels a side: a pixel's noise, or an edge
/// that is not quite in its place, would make every gain too small.
const CELL_PX: usize = 16;

/// A cell is compared if it is this opaque in the mean. (Black shows through what is left.)
const MIN_ALPHA: f32 = 0.98;

/// A channel this near to either end of its range may be clipped.
const CLIPPED: std::ops::RangeInclusive<f32> = 0.02..=0.98;

/// Standard deviation of a cell's difference that is no matter of exposure.
const CELL_NOISE: f64 = 0.03;

/// Standard deviations of gains about 1 and of offsets about 0, as cameras show them. They tie a
/// keyframe that has little to compare to what it measured.
const GAIN_SPREAD: f64 = 0.2;
const OFFSET_SPREAD: f64 = 0.05;

/// `map's colour = gain * measured colour + offset`, for each channel; colours 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Exposure {
    gains: [f32; 3],
    offsets: [f32; 3],
}

impl Exposure {
    /// The most probable exposure of a keyframe, given what the map shows at its view: least squares
    /// over cells, tied to the identity. Both images have the same size.
    pub fn between(measured: &Target, rendered: &Rendered) -> Self {
        let cells = cells(measured, rendered);
        let channels: [_; 3] = std::array::from_fn(|channel| fitted(&cells, channel));
        Self {
            gains: channels.map(|[gain, _]| gain),
            offsets: channels.map(|[_, offset]| offset),
        }
    }

    /// A measured image as the map's exposure would show it.
    pub fn applied(&self, color: &Image<[u8; 3]>) -> Image<[u8; 3]> {
        let tables: [[u8; 256]; 3] = std::array::from_fn(|channel| {
            std::array::from_fn(|value| {
                let value = self.gains[channel] * value as f32 + 255.0 * self.offsets[channel];
                // Saturates.
                value.round() as u8
            })
        });
        color.map(|pixel| {
            std::array::from_fn(|channel| tables[channel][usize::from(pixel[channel])])
        })
    }
}

/// The mean colours of a cell.
struct Cell {
    measured: [f32; 3],
    rendered: [f32; 3],
}

/// The cells in which the map is opaque and every colour was seen.
fn cells(measured: &Target, rendered: &Rendered) -> Vec<Cell> {
    let color = measured.color();
    let mut cells = Vec::new();
    for top in (0..color.height() / CELL_PX).map(|row| row * CELL_PX) {
        for left in (0..color.width() / CELL_PX).map(|column| column * CELL_PX) {
            let pixels =
                (top..top + CELL_PX).flat_map(|v| (left..left + CELL_PX).map(move |u| (u, v)));
            let seen = |(u, v)| measured.color_valid().is_none_or(|valid| valid.at(u, v));
            if !pixels.clone().all(seen) {
                continue;
            }
            let share = 1.0 / (CELL_PX * CELL_PX) as f32;
            let mut alpha = 0.0;
            let mut cell = Cell {
                measured: [0.0; 3],
                rendered: [0.0; 3],
            };
            for (u, v) in pixels {
                alpha += share * rendered.alpha.at(u, v);
                for channel in 0..3 {
                    cell.measured[channel] += share * f32::from(color.at(u, v)[channel]) / 255.0;
                    cell.rendered[channel] += share * rendered.color.at(u, v)[channel];
                }
            }
            if alpha >= MIN_ALPHA {
                cells.push(cell);
            }
        }
    }
    cells
}

/// Gain and offset of a channel: minimises `sum ((g m + o - r) / CELL_NOISE)^2 + ((g - 1) /
/// GAIN_SPREAD)^2 + (o / OFFSET_SPREAD)^2`.
fn fitted(cells: &[Cell], channel: usize) -> [f32; 2] {
    let mut normal =
        Matrix2::from_diagonal(&Vector2::new(GAIN_SPREAD.powi(-2), OFFSET_SPREAD.powi(-2)));
    let mut right = Vector2::zeros();
    for cell in cells {
        let (measured, rendered) = (cell.measured[channel], cell.rendered[channel]);
        if CLIPPED.contains(&measured) && rendered.is_finite() {
            let row = Vector2::new(f64::from(measured), 1.0);
            let weight = CELL_NOISE.powi(-2);
            normal += weight * row * row.transpose();
            right += weight * f64::from(rendered - measured) * row;
        }
    }
    // Positive definite: the ties alone are.
    let step = normal
        .try_inverse()
        .map_or(right * 0.0, |inverse| inverse * right);
    [(1.0 + step.x) as f32, step.y as f32]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stripes of many colours, 64x48.
    fn scene() -> Image<[f32; 3]> {
        Image::from_fn(64, 48, |u, v| {
            let at = |speed: usize| 0.2 + 0.5 * ((u / 16 * speed + v / 16 * 3) % 7) as f32 / 7.0;
            [at(1), at(2), at(5)]
        })
    }

    fn target(color: &Image<[f32; 3]>) -> Target {
        let bytes = color.map(|pixel| pixel.map(|value| (255.0 * value).round() as u8));
        let depth_m = Image::from_fn(bytes.width(), bytes.height(), |_, _| 1.0);
        Target::new(bytes, depth_m).unwrap()
    }

    fn rendered(color: Image<[f32; 3]>, alpha: f32) -> Rendered {
        let image = |value| Image::from_fn(color.width(), color.height(), |_, _| value);
        Rendered {
            depth_m: image(1.0),
            alpha: image(alpha),
            color,
        }
    }

    #[test]
    fn gain_and_offset_of_each_channel_are_found() {
        let (gains, offsets) = ([0.8, 1.1, 1.25], [0.03, -0.02, 0.01]);
        let measured = scene();
        let shown = measured.map(|pixel| {
            std::array::from_fn(|channel| gains[channel] * pixel[channel] + offsets[channel])
        });
        let exposure = Exposure::between(&target(&measured), &rendered(shown.clone(), 1.0));
        let brought = exposure.applied(target(&measured).color());
        for (brought, shown) in brought.data().iter().zip(shown.data()) {
            for channel in 0..3 {
                let error = f32::from(brought[channel]) / 255.0 - shown[channel];
                assert!(error.abs() <= 0.012, "{exposure:?}: {brought:?} {shown:?}");
            }
        }
    }

    #[test]
    fn where_the_map_shows_nothing_colours_stay() {
        let dark = scene().map(|pixel| pixel.map(|value| 0.5 * value));
        let exposure = Exposure::between(&target(&scene()), &rendered(dark, 0.5));
        let color = target(&scene());
        assert_eq!(exposure.applied(color.color()), *color.color());
    }

    #[test]
    fn clipped_colours_and_damaged_renders_say_nothing() {
        let white = Image::from_fn(64, 48, |_, _| [1.0; 3]);
        let gray = Image::from_fn(64, 48, |_, _| [0.5, f32::NAN, f32::INFINITY]);
        let exposure = Exposure::between(&target(&white), &rendered(gray, 1.0));
        assert_eq!((exposure.gains, exposure.offsets), ([1.0; 3], [0.0; 3]));
    }

    /// One colour alone does not tell gain from offset: both are used, each within its spread.
    #[test]
    fn one_colour_moves_both_a_little() {
        let flat = Image::from_fn(64, 48, |_, _| [0.4; 3]);
        let shown = Image::from_fn(64, 48, |_, _| [0.44; 3]);
        let exposure = Exposure::between(&target(&flat), &rendered(shown, 1.0));
        let ([gain, ..], [offset, ..]) = (exposure.gains, exposure.offsets);
        assert!((gain * 0.4 + offset - 0.44).abs() <= 0.005);
        assert!((1.01..1.1).contains(&gain) && (0.005..0.03).contains(&offset));
    }
}
