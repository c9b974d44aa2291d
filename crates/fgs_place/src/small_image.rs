//! A frame reduced to a few cells, so that noise, blur and small motions do not matter.

use std::ops::Range;

use fgs_geom::{Image, RgbdFrame, has_depth};

/// Columns of cells. Images of twice the resolution did not do better.
pub const WIDTH: usize = 20;
/// Rows of cells.
pub const HEIGHT: usize = 15;

/// Weights of the neighbours 0 to 3 cells away: a Gaussian of one cell.
const BLUR: [f64; 4] = [0.399_1, 0.242_0, 0.054_0, 0.004_45];

/// A cell has colour or depth if at least this share of its pixels, neighbours included, has.
const MIN_SHARE: f64 = 0.3;

/// What a cell and its surroundings show.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cell {
    /// Brightness, red against blue, green against both, in 8-bit steps; each is a difference or
    /// sum of channels, and so follows a change of exposure in proportion. `None` where the camera
    /// saw nothing.
    pub color: Option<[f64; 3]>,
    /// Mean depth, metres.
    pub depth_m: Option<f64>,
}

/// Averages over pixels: red, green, blue, share with colour, depth, share with depth. Pixels
/// without a value count as 0.
type Averages = [f64; 6];

/// The cells of `frame`, which may have any size: a frame with fewer pixels repeats them.
pub fn small_image(frame: &RgbdFrame) -> Image<Cell> {
    let averages = Image::from_fn(WIDTH, HEIGHT, |u, v| {
        let columns = pixels(u, WIDTH, frame.camera.width);
        average(frame, columns, pixels(v, HEIGHT, frame.camera.height))
    });
    let rows = Image::from_fn(WIDTH, HEIGHT, |u, v| {
        blur(|offset| averages.at(moved(u, offset, WIDTH), v))
    });
    Image::from_fn(WIDTH, HEIGHT, |u, v| {
        let [r, g, b, with_color, depth_m, with_depth] =
            blur(|offset| rows.at(u, moved(v, offset, HEIGHT)));
        Cell {
            color: (with_color >= MIN_SHARE)
                .then(|| [r + g + b, r - b, 2.0 * g - r - b].map(|value| value / with_color)),
            depth_m: (with_depth >= MIN_SHARE).then(|| depth_m / with_depth),
        }
    })
}

/// The pixels of cell `cell` of `cells` along a side of `len` pixels; at least one.
fn pixels(cell: usize, cells: usize, len: usize) -> Range<usize> {
    let start = cell * len / cells;
    start..((cell + 1) * len / cells).max(start + 1)
}

fn average(frame: &RgbdFrame, columns: Range<usize>, rows: Range<usize>) -> Averages {
    let area = (columns.len() * rows.len()) as f64;
    let mut sums = [0.0; 6];
    for v in rows {
        let depth_m = &frame.depth_m.row(v)[columns.clone()];
        let (mut sum_m, mut measured) = (0.0, 0_u32);
        for &depth_m in depth_m {
            let has_depth = has_depth(depth_m);
            sum_m += if has_depth { f64::from(depth_m) } else { 0.0 };
            measured += u32::from(has_depth);
        }
        let color = &frame.color.row(v)[columns.clone()];
        let (rgb, seen) = match &frame.color_valid {
            None => sum_color(color.iter()),
            Some(valid) => {
                let valid = &valid.row(v)[columns.clone()];
                sum_color(
                    color
                        .iter()
                        .zip(valid)
                        .filter(|seen| *seen.1)
                        .map(|seen| seen.0),
                )
            }
        };
        let [r, g, b] = rgb.map(f64::from);
        let row = [r, g, b, f64::from(seen), sum_m, f64::from(measured)];
        for (sum, value) in sums.iter_mut().zip(row) {
            *sum += value;
        }
    }
    sums.map(|sum| sum / area)
}

/// The sum of some pixels of a row, and their number.
fn sum_color<'a>(pixels: impl Iterator<Item = &'a [u8; 3]>) -> ([u32; 3], u32) {
    pixels.fold(([0; 3], 0), |([r, g, b], count), pixel| {
        let [dr, dg, db] = pixel.map(u32::from);
        ([r + dr, g + dg, b + db], count + 1)
    })
}

/// The weighted mean of the values up to three cells to either side.
fn blur(at: impl Fn(isize) -> Averages) -> Averages {
    let mut sum = [0.0; 6];
    for offset in -3..=3_isize {
        let weight = BLUR[offset.unsigned_abs()];
        for (sum, value) in sum.iter_mut().zip(at(offset)) {
            *sum += weight * value;
        }
    }
    sum
}

/// Coordinate `at` moved by `offset`, but not out of `0..len`.
fn moved(at: usize, offset: isize, len: usize) -> usize {
    at.saturating_add_signed(offset).min(len - 1)
}
