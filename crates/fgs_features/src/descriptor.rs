//! What is around a corner in 256 bits: BRIEF (Calonder et al. 2010), turned with the patch as in
//! ORB (Rublee et al. 2011).
//!
//! Each bit compares the brightness of two places of a smoothed patch. The places are drawn from a
//! normal distribution around the corner, BRIEF's best choice, by a generator with a fixed seed.

use std::f64::consts::TAU;
use std::sync::LazyLock;

use fgs_geom::Image;
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::corners::BORDER;

/// One bit for each pair of places.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Descriptor(pub [u64; 4]);

impl Descriptor {
    /// The number of bits that differ, 0 to 256.
    #[inline(always)]
    pub fn distance(&self, other: &Self) -> u32 {
        let bits = |i: usize| (self.0[i] ^ other.0[i]).count_ones();
        bits(0) + bits(1) + bits(2) + bits(3)
    }
}

/// Radius of the patch, pixels.
const RADIUS: isize = BORDER as isize - 1;

/// Standard deviation of the places compared: a fifth of the patch's width.
const SPREAD_PX: f64 = 6.2;

/// Seed of the pattern.
const SEED: u64 = 1;

/// Directions in which the pattern is prepared.
const DIRECTIONS: usize = 64;

/// Two places, columns and rows from the corner.
type Pair = [[i8; 2]; 2];

/// The pattern in each direction.
static PATTERNS: LazyLock<Vec<[Pair; 256]>> = LazyLock::new(|| {
    let mut rng = Pcg64Mcg::seed_from_u64(SEED);
    let pattern: [[[f64; 2]; 2]; 256] =
        std::array::from_fn(|_| std::array::from_fn(|_| random_place(&mut rng)));
    let turned = |direction: usize| {
        let (sin, cos) = (TAU * direction as f64 / DIRECTIONS as f64).sin_cos();
        pattern.map(|pair| {
            pair.map(|[x, y]| [cos * x - sin * y, sin * x + cos * y].map(|c| c.round() as i8))
        })
    };
    (0..DIRECTIONS).map(turned).collect()
});

/// A place in the patch, normally distributed by the method of Box and Muller.
fn random_place(rng: &mut impl Rng) -> [f64; 2] {
    loop {
        let length = SPREAD_PX * (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
        if length <= RADIUS as f64 {
            let (sin, cos) = (TAU * rng.random::<f64>()).sin_cos();
            return [length * cos, length * sin];
        }
    }
}

/// Weights of a normal distribution with a standard deviation of 2 pixels, in 256ths.
const SMOOTHING: [u16; 7] = [18, 34, 49, 54, 49, 34, 18];

/// The image smoothed, so that a bit does not hang on the noise of two pixels. The border of 3
/// pixels, which no descriptor reads, stays as it is.
pub(crate) fn smoothed(image: &Image<u8>) -> Image<u8> {
    let (width, height) = (image.width(), image.height());
    let mut columns = image.clone();
    for v in 3..height.saturating_sub(3) {
        let rows: [&[u8]; 7] = std::array::from_fn(|i| image.row(v + i - 3));
        let out = &mut columns.data_mut()[v * width..][..width];
        for (u, out) in out.iter_mut().enumerate() {
            let sum = (0..7)
                .map(|i| SMOOTHING[i] * u16::from(rows[i][u]))
                .sum::<u16>();
            *out = (sum >> 8) as u8;
        }
    }
    let mut smooth = columns.clone();
    if width > 6 {
        for v in 0..height {
            let row = columns.row(v);
            let shifted: [&[u8]; 7] = std::array::from_fn(|i| &row[i..][..width - 6]);
            let out = &mut smooth.data_mut()[v * width + 3..][..width - 6];
            for (u, out) in out.iter_mut().enumerate() {
                let sum = (0..7)
                    .map(|i| SMOOTHING[i] * u16::from(shifted[i][u]))
                    .sum::<u16>();
                *out = (sum >> 8) as u8;
            }
        }
    }
    smooth
}

/// The descriptor of a corner at least [`BORDER`] pixels from the border, turned by the direction
/// from it to the centre of brightness of its patch.
pub(crate) fn describe(image: &Image<u8>, smooth: &Image<u8>, u: usize, v: usize) -> Descriptor {
    let turns = direction(image, u, v) / TAU;
    let pattern = &PATTERNS[(turns * DIRECTIONS as f64).round() as usize % DIRECTIONS];
    let at = v * smooth.width() + u;
    let brightness = |[x, y]: [i8; 2]| {
        let shift = y as isize * smooth.width() as isize + x as isize;
        smooth.data()[at.wrapping_add_signed(shift)]
    };
    Descriptor(std::array::from_fn(|word| {
        let pairs = &pattern[64 * word..][..64];
        let bits = pairs.iter().enumerate().map(|(bit, [first, second])| {
            u64::from(brightness(*first) < brightness(*second)) << bit
        });
        bits.sum()
    }))
}

/// The half width of each row of a disk.
static DISK: LazyLock<[usize; 2 * BORDER - 1]> = LazyLock::new(|| {
    std::array::from_fn(|row| {
        let y = row as isize - RADIUS;
        ((RADIUS * RADIUS - y * y) as f64).sqrt() as usize
    })
});

/// The direction from the patch's centre to its centre of brightness, 0 to 2 pi, from x to y.
fn direction(image: &Image<u8>, u: usize, v: usize) -> f64 {
    let (mut x_sum, mut y_sum) = (0_i32, 0_i32);
    for (row, half) in DISK.iter().enumerate() {
        let pixels = &image.row(v + row - RADIUS as usize)[u - half..=u + half];
        let (mut sum, mut moment) = (0_i32, 0_i32);
        for (i, value) in pixels.iter().enumerate() {
            sum += i32::from(*value);
            moment += i as i32 * i32::from(*value);
        }
        x_sum += moment - *half as i32 * sum;
        y_sum += (row as i32 - RADIUS as i32) * sum;
    }
    f64::from(y_sum).atan2(f64::from(x_sum)).rem_euclid(TAU)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A smooth random texture turned by an angle around the middle of the image.
    fn texture(angle: f64) -> Image<u8> {
        let (sin, cos) = angle.sin_cos();
        Image::from_fn(64, 64, |u, v| {
            let (x, y) = (u as f64 - 32.0, v as f64 - 32.0);
            let (x, y) = (cos * x + sin * y, cos * y - sin * x);
            let waves = (0.31 * x + 0.2 * y + 0.4).sin() + (0.45 * y - 0.17 * x).cos();
            (128.0 + 40.0 * waves + 20.0 * (0.9 * x).sin() + 0.6 * x) as u8
        })
    }

    fn describe_middle(image: &Image<u8>) -> Descriptor {
        describe(image, &smoothed(image), 32, 32)
    }

    #[test]
    fn a_turned_patch_looks_the_same() {
        let straight = describe_middle(&texture(0.0));
        for angle in [0.3, 1.0, 2.5, -2.0] {
            let distance = straight.distance(&describe_middle(&texture(angle)));
            assert!(distance <= 40, "{angle}: {distance}");
        }
        let other = describe(&texture(0.0), &smoothed(&texture(0.0)), 40, 27);
        assert!(straight.distance(&other) >= 80);
    }

    #[test]
    fn gain_and_offset_change_nothing() {
        let image = texture(0.7).map(|value| value & !1);
        let half = image.map(|value| value / 2 + 60);
        let distance = describe_middle(&image).distance(&describe_middle(&half));
        assert!(distance <= 6, "{distance}");
    }

    #[test]
    fn the_direction_is_that_of_the_bright_side() {
        for (x, y) in [(1.0, 0.0), (0.0, 1.0), (-3.0, 1.0), (1.0, -2.0)] {
            let ramp = Image::from_fn(40, 40, |u, v| {
                (128.0 + x * (u as f64 - 20.0) + y * (v as f64 - 20.0)) as u8
            });
            let difference = direction(&ramp, 20, 20) - f64::atan2(y, x).rem_euclid(TAU);
            assert!(
                difference.sin().abs() <= 0.02 && difference.cos() > 0.0,
                "({x}, {y})"
            );
        }
    }

    #[test]
    fn smoothing_keeps_a_plain_image_and_spreads_a_point() {
        let plain = Image::filled(20, 15, 255);
        assert_eq!(smoothed(&plain), plain);
        let point = Image::from_fn(20, 15, |u, v| if (u, v) == (9, 8) { 255 } else { 0 });
        let smooth = smoothed(&point);
        assert_eq!(smooth.at(9, 8), 11); // 255 (54 / 256)^2 is 11.3
        assert!(smooth.at(12, 8) > 0 && smooth.at(13, 8) == 0 && smooth.at(9, 12) == 0);
    }
}
