//! Contrast-limited adaptive histogram equalisation (K. Zuiderveld, Graphics Gems IV, 1994), equal
//! to OpenCV's CLAHE.
//!
//! In and out: an 8-bit image. Each tile of a grid has a table of its own, the cumulated histogram
//! with its bars clipped; a pixel is mapped by the tables of the four nearest tiles, bilinearly.

use fgs_geom::Image;

use super::border::{Border, reflect};
use super::byte_from_float;

/// The grid has this many tiles along either side, whatever the image's size.
const GRID: usize = 32;

/// A histogram's bar may be this many times the mean bar.
const CLIP: f64 = 2.0;

/// The new level of each level, a whole number.
type Table = [f32; 256];

/// The equalised image, of at least one pixel.
pub(super) fn equalize(image: &Image<u8>) -> Image<u8> {
    let (width, height) = (image.width(), image.height());
    // OpenCV extends a side that is already a multiple by one whole grid if the other is not.
    let extension = |size: usize| {
        if width.is_multiple_of(GRID) && height.is_multiple_of(GRID) {
            0
        } else {
            GRID - size % GRID
        }
    };
    let extended = reflect(
        image,
        Border {
            left: 0,
            top: 0,
            right: extension(width),
            bottom: extension(height),
        },
    );
    let (tile_width, tile_height) = (extended.width() / GRID, extended.height() / GRID);
    let tables: Vec<Table> = (0..GRID * GRID)
        .map(|tile| {
            let (left, top) = (tile % GRID * tile_width, tile / GRID * tile_height);
            let rows = (top..top + tile_height).map(|v| &extended.row(v)[left..left + tile_width]);
            clipped_equalization(rows, tile_width * tile_height)
        })
        .collect();

    let columns = neighbors(width, tile_width);
    let rows = neighbors(height, tile_height);
    let mut equalized = image.clone();
    for (row, mut levels) in rows.iter().zip(equalized.data_mut().chunks_mut(width)) {
        // Between the centres of four tiles their tables stay the same.
        for run in columns.chunk_by(|a, b| (a.before, a.after) == (b.before, b.after)) {
            let table = |row: usize, column: usize| &tables[row * GRID + column];
            let [upper, lower] = [row.before, row.after]
                .map(|row| [run[0].before, run[0].after].map(|column| table(row, column)));
            let (here, rest) = levels.split_at_mut(run.len());
            levels = rest;
            for (column, level) in run.iter().zip(here) {
                let blend = |tables: [&Table; 2]| {
                    let [before, after] = tables.map(|table| table[usize::from(*level)]);
                    before * (1.0 - column.fraction) + after * column.fraction
                };
                let value = blend(upper) * (1.0 - row.fraction) + blend(lower) * row.fraction;
                *level = byte_from_float(value);
            }
        }
    }
    equalized
}

/// The table that equalises a tile of `area` pixels.
fn clipped_equalization<'a>(rows: impl Iterator<Item = &'a [u8]>, area: usize) -> Table {
    let mut histogram = [0_usize; 256];
    for &level in rows.flatten() {
        histogram[usize::from(level)] += 1;
    }
    let limit = ((CLIP * area as f64 / 256.0) as usize).max(1);
    let mut excess = 0;
    for count in &mut histogram {
        excess += count.saturating_sub(limit);
        *count = (*count).min(limit);
    }
    // The excess is spread evenly; what is left of it goes to every few levels, from 0 up.
    let (share, rest) = (excess / 256, excess % 256);
    for count in &mut histogram {
        *count += share;
    }
    if let Some(step) = 256_usize.checked_div(rest) {
        for count in histogram.iter_mut().step_by(step).take(rest) {
            *count += 1;
        }
    }
    let scale = 255.0 / area as f32;
    let mut cumulated = 0;
    histogram.map(|count| {
        cumulated += count;
        f32::from(byte_from_float(cumulated as f32 * scale))
    })
}

/// The tiles before and after a pixel along one axis, and how far it is from the centre of the one
/// towards the centre of the other.
struct Neighbors {
    before: usize,
    after: usize,
    fraction: f32,
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

    /// Tiles of one or two pixels, a size that needs both extensions, one where a
    /// side is a multiple of the grid and is extended all the same, one without extension.
    #[test]
    fn equals_opencv() {
        for size in ["20x44", "333x215", "320x181", "320x192"] {
            let equalized = equalize(&golden(&format!("gray_{size}")));
            let expected = golden(&format!("equalized_{size}"));
            let differing = (equalized.data().iter())
                .zip(expected.data())
                .filter(|(a, b)| a != b)
                .count();
            assert_eq!(differing, 0, "{size}");
        }
    }

    #[test]
    fn a_constant_image_stays_constant() {
        let equalized = equalize(&Image::filled(50, 40, 77));
        assert_eq!(equalized, Image::filled(50, 40, equalized.at(0, 0)));
    }
}
