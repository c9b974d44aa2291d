//! Grey images of a frame at falling resolution.
//!
//! 8 bits a pixel rather than the floats of direct alignment: corners and descriptors only compare
//! brightnesses, and four times as many fit in a register.

use fgs_geom::{Image, RgbdFrame};

/// The pixels of a level are this much wider than those of the level before it.
const STEP: f64 = std::f64::consts::SQRT_2;

/// Levels at most.
const MAX_LEVELS: usize = 5;

/// One resolution.
pub(crate) struct Level {
    pub pixels: Image<u8>,
    /// The width of a pixel in pixels of the frame.
    pub scale: f64,
}

/// The frame's colour image at several resolutions, finest first, without those whose shorter side
/// is below `min_side` pixels.
pub(crate) fn pyramid(frame: &RgbdFrame, min_side: usize) -> Vec<Level> {
    let mut levels = Vec::new();
    let (mut pixels, mut scale) = (grey(&frame.color), 1.0);
    while levels.len() < MAX_LEVELS && pixels.width().min(pixels.height()) >= min_side {
        let smaller = shrink(&pixels, STEP);
        levels.push(Level { pixels, scale });
        (pixels, scale) = (smaller, scale * STEP);
    }
    levels
}

/// Luma of ITU-R BT.601.
fn grey(color: &Image<[u8; 3]>) -> Image<u8> {
    color.map(|[r, g, b]| {
        ((77 * u32::from(*r) + 150 * u32::from(*g) + 29 * u32::from(*b) + 128) >> 8) as u8
    })
}

/// The image with pixels `factor` times as wide (1 to 2), interpolated bilinearly; at 2, the mean
/// of four. A remainder at the right and lower border is dropped.
fn shrink(image: &Image<u8>, factor: f64) -> Image<u8> {
    let size = |n: usize| (n as f64 / factor) as usize;
    let columns = taps(size(image.width()), image.width(), factor);
    let rows = taps(size(image.height()), image.height(), factor);
    let mut data = Vec::with_capacity(columns.len() * rows.len());
    for (v, below) in &rows {
        let upper = image.row(*v);
        let lower = image.row((v + 1).min(image.height() - 1));
        data.extend(columns.iter().map(|(u, right)| {
            let next = (u + 1).min(upper.len() - 1);
            let mix =
                |row: &[u8]| u32::from(row[*u]) * (256 - right) + u32::from(row[next]) * right;
            ((mix(upper) * (256 - below) + mix(lower) * below + (1 << 15)) >> 16) as u8
        }));
    }
    Image::from_fn(columns.len(), rows.len(), |u, v| {
        data[v * columns.len() + u]
    })
}

/// For each new pixel, the old pixel before its centre and the weight of the next one, in 256ths.
fn taps(count: usize, old_count: usize, factor: f64) -> Vec<(usize, u32)> {
    let tap = |i: usize| {
        let at = ((i as f64 + 0.5) * factor - 0.5).clamp(0.0, (old_count - 1) as f64);
        (at as usize, (256.0 * at.fract()) as u32)
    };
    (0..count).map(tap).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_linear_image_stays_linear() {
        let image = Image::from_fn(64, 48, |u, v| (2 * u + v) as u8);
        for factor in [1.2, STEP, 2.0] {
            let smaller = shrink(&image, factor);
            assert_eq!(smaller.width(), (64.0 / factor) as usize);
            for (u, v) in [(0, 0), (20, 7), (31, 23)] {
                let old = |i: usize| (i as f64 + 0.5) * factor - 0.5;
                let expected = 2.0 * old(u) + old(v);
                assert!(
                    (f64::from(smaller.at(u, v)) - expected).abs() <= 0.51 + 0.02,
                    "({u}, {v})"
                );
            }
        }
    }
}
