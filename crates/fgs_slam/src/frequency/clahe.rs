//! Contrast-limited adaptive histogram equalisation (K. Zuiderveld, Graphics Gems IV, 1994), equal
//! to OpenCV's CLAHE.
//!
//! In and out: an 8-bit image. Each tile of a grid has a table of its own, the cumulated histogram
//! with its bars clipped; a pixel is mapped by the tables of the four nearest tiles, bilinearly.

use std::ops::Range;

use fgs_geom::{Image, Kernel, dispatch};

use super::border::{Border, reflect};
use super::byte_from_float;
use super::histogram::histogram;

/// The grid has this many tiles along either side, whatever the image's size.
const GRID: usize = 32;

/// A histogram's bar may be this many times the mean bar.
const CLIP: f64 = 2.0;

/// The new level of each level.
type Table = [u8; 256];

/// The new levels of each level by the four nearest tables: upper left, upper right, lower left,
/// lower right, from the lowest byte up. One look-up finds them all.
type FourTables = [u32; 256];

/// Equalises images of one size, of at least one pixel.
pub(super) struct Equalizer {
    extension: Border,
    /// The image, extended to a multiple of the grid.
    extended: Image<u8>,
    columns: Vec<Neighbors>,
    rows: Vec<Neighbors>,
    column_fractions: Vec<f32>,
    /// Runs of columns, and of rows, between the centres of the same tiles.
    column_runs: Vec<Range<usize>>,
    row_runs: Vec<Range<usize>>,
    tables: Vec<Table>,
    /// Those of a row of tiles, from left to right.
    four_tables: Vec<FourTables>,
    /// What they give for a row of pixels.
    four_levels: Vec<u32>,
}

impl Equalizer {
    pub fn new(width: usize, height: usize) -> Self {
        // OpenCV extends a side that is already a multiple by one whole grid if the other is not.
        let extension = |size: usize| {
            if width.is_multiple_of(GRID) && height.is_multiple_of(GRID) {
                0
            } else {
                GRID - size % GRID
            }
        };
        let extension = Border {
            left: 0,
            top: 0,
            right: extension(width),
            bottom: extension(height),
        };
        let extended = extension.canvas(width, height);
        let columns = neighbors(width, extended.width() / GRID);
        let rows = neighbors(height, extended.height() / GRID);
        Self {
            extension,
            column_fractions: columns.iter().map(|column| column.fraction).collect(),
            column_runs: runs(&columns),
            row_runs: runs(&rows),
            columns,
            rows,
            extended,
            tables: vec![[0; 256]; GRID * GRID],
            // There is a run before the first centre, and one after each.
            four_tables: vec![[0; 256]; GRID + 1],
            four_levels: vec![0; width],
        }
    }

    /// Equalises an image in place.
    pub fn equalize(&mut self, image: &mut Image<u8>) {
        reflect(image, self.extension, &mut self.extended);
        let (width, height) = (self.extended.width() / GRID, self.extended.height() / GRID);
        for (tile, table) in self.tables.iter_mut().enumerate() {
            let (left, top) = (tile % GRID * width, tile / GRID * height);
            let rows = (top..top + height).map(|v| &self.extended.row(v)[left..left + width]);
            *table = clipped_equalization(histogram(rows), width * height);
        }
        dispatch(Interpolation {
            equalizer: self,
            image,
        });
    }
}

/// Maps each pixel by the tables of the four nearest tiles, compiled for each instruction set.
struct Interpolation<'a> {
    equalizer: &'a mut Equalizer,
    image: &'a mut Image<u8>,
}

impl Kernel for Interpolation<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool, const WIDTH: usize>(self) {
        let Equalizer {
            columns,
            rows,
            column_fractions,
            column_runs,
            row_runs,
            tables,
            four_tables,
            four_levels,
            ..
        } = self.equalizer;
        let width = self.image.width();
        for band in row_runs {
            let (upper, lower) = (rows[band.start].before, rows[band.start].after);
            for (run, four) in column_runs.iter().zip(&mut *four_tables) {
                let (left, right) = (columns[run.start].before, columns[run.start].after);
                let table = |row: usize, column: usize| &tables[row * GRID + column];
                let [a, b] = [left, right].map(|column| table(upper, column));
                let [c, d] = [left, right].map(|column| table(lower, column));
                for (i, four) in four.iter_mut().enumerate() {
                    *four = u32::from_le_bytes([a[i], b[i], c[i], d[i]]);
                }
            }
            for v in band.clone() {
                let line = &mut self.image.data_mut()[v * width..][..width];
                for (run, table) in column_runs.iter().zip(&*four_tables) {
                    let four_levels = four_levels[run.clone()].iter_mut();
                    for (four, &level) in four_levels.zip(&line[run.clone()]) {
                        *four = table[usize::from(level)];
                    }
                }
                blend(four_levels, column_fractions, rows[v].fraction, line);
            }
        }
    }
}

/// Bilinear interpolation of a row of pixels between the new levels that four tables give each.
#[inline(always)]
fn blend(four_levels: &[u32], fractions: &[f32], row_fraction: f32, line: &mut [u8]) {
    for ((four, &fraction), level) in four_levels.iter().zip(fractions).zip(line) {
        let [a, b, c, d] = [0, 8, 16, 24].map(|shift| (four >> shift & 255) as i32 as f32);
        let upper = a * (1.0 - fraction) + b * fraction;
        let lower = c * (1.0 - fraction) + d * fraction;
        *level = byte_from_float(upper * (1.0 - row_fraction) + lower * row_fraction);
    }
}

/// The table that equalises a tile of `area` pixels with a histogram.
fn clipped_equalization(mut histogram: [u32; 256], area: usize) -> Table {
    let limit = ((CLIP * area as f64 / 256.0) as u32).max(1);
    let mut excess = 0;
    for count in &mut histogram {
        excess += count.saturating_sub(limit);
        *count = (*count).min(limit);
    }
    // The excess is spread evenly; what is left of it goes to every few levels, from 0 up.
    let (share, rest) = (excess / 256, excess as usize % 256);
    if let Some(step) = 256_usize.checked_div(rest) {
        for count in histogram.iter_mut().step_by(step).take(rest) {
            *count += 1;
        }
    }
    let scale = 255.0 / area as f32;
    let (mut cumulated, mut table) = (0, [0; 256]);
    for (level, count) in table.iter_mut().zip(histogram) {
        cumulated += count + share;
        *level = byte_from_float(cumulated as f32 * scale);
    }
    table
}

/// The tiles before and after a pixel along one axis, and how far it is from the centre of the one
/// towards the centre of the other.
struct Neighbors {
    before: usize,
    after: usize,
    fraction: f32,
}

/// Runs of pixels between the centres of the same two tiles, within which the tables stay the same.
fn runs(pixels: &[Neighbors]) -> Vec<Range<usize>> {
    let mut end = 0;
    pixels
        .chunk_by(|a, b| (a.before, a.after) == (b.before, b.after))
        .map(|run| {
            end += run.len();
            end - run.len()..end
        })
        .collect()
}

fn neighbors(len: usize, tile_len: usize) -> Vec<Neighbors> {
    let tiles_per_pixel = 1.0 / tile_len as f32;
    let of = |pixel: usize| {
        let position = pixel as f32 * tiles_per_pixel - 0.5;
        let before = position.floor();
        Neighbors {
            before: before.max(0.0) as usize,
            after: ((before + 1.0) as usize).min(GRID - 1),
            fraction: position - before,
        }
    };
    (0..len).map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn golden(name: &str) -> Image<u8> {
        let path = format!(
            "{}/tests/golden/frequency/{name}.png",
            env!("CARGO_MANIFEST_DIR")
        );
        let image = image::open(path).unwrap().into_luma8();
        let (width, height) = image.dimensions();
        Image::new(width as usize, height as usize, image.into_raw()).unwrap()
    }

    fn equalized(mut image: Image<u8>) -> Image<u8> {
        Equalizer::new(image.width(), image.height()).equalize(&mut image);
        image
    }

    /// Tiles of one or two pixels, a size that needs both extensions, one where a
    /// side is a multiple of the grid and is extended all the same, one without extension.
    #[test]
    fn equals_opencv() {
        for size in ["20x44", "333x215", "320x181", "320x192"] {
            let equalized = equalized(golden(&format!("gray_{size}")));
            let expected = golden(&format!("equalized_{size}"));
            let differing = (equalized.data().iter())
                .zip(expected.data())
                .filter(|(a, b)| a != b)
                .count();
            assert_eq!(differing, 0, "{size}");
        }
    }

    /// A tile large enough for its excess to be spread over all levels.
    #[test]
    fn what_is_clipped_is_spread_evenly() {
        let mut histogram = [0; 256];
        histogram[77] = 2560;
        let table = clipped_equalization(histogram, 2560);
        // The bar is cut at 20. The rest, 9 * 256 + 236, gives the first 236 levels one more.
        for (level, &found) in table.iter().enumerate() {
            let bars = 9 * (level + 1) + (level + 1).min(236) + if level < 77 { 0 } else { 20 };
            let expected = (bars as f64 * 255.0 / 2560.0).round_ties_even();
            assert_eq!(f64::from(found), expected, "{level}");
        }
    }

    #[test]
    fn a_constant_image_stays_constant() {
        let equalized = equalized(Image::filled(50, 40, 77));
        assert_eq!(equalized, Image::filled(50, 40, equalized.at(0, 0)));
    }
}
