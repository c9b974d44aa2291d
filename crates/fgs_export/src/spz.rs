//! Gaussians as an SPZ file of version 3 (Niantic): a gzip stream of a 16-byte header and one array
//! for each property.
//!
//! Positions are fixed-point numbers of 24 bits, opacities, colours and log-scales bytes, rotations
//! their three smaller components in 32 bits. Axes as the format wants them: x right, y up, z backward,
//! metres.

use std::io::{self, Write};

use fgs_splat::Gaussians;
use flate2::Compression;
use flate2::write::GzEncoder;

use crate::quantities::{byte, index_of_largest, unit_quat, y_up, y_up_quat};

const MAGIC: u32 = 0x5053_474e;
const VERSION: u32 = 3;
/// Positions are integers of 24 bits.
const MAX_POSITION: f32 = 8_388_607.0;
/// Steps of 15 micrometres up to 128 m from the first camera; finer ones would only cost space.
const MAX_FRACTIONAL_BITS: u8 = 16;
/// Of a byte's range, so much stands for a unit of a spherical-harmonics coefficient.
const COLOR_SCALE: f32 = 0.15;

/// Writes all gaussians.
///
/// # Errors
/// If writing fails or there are 2^32 gaussians or more.
pub fn write_spz(out: &mut impl Write, gaussians: &Gaussians) -> io::Result<()> {
    let count = u32::try_from(gaussians.len()).map_err(io::Error::other)?;
    let fractional_bits = fractional_bits(gaussians);
    let mut out = GzEncoder::new(out, Compression::default());
    for word in [MAGIC, VERSION, count] {
        out.write_all(&word.to_le_bytes())?;
    }
    let (degree, flags, reserved) = (0, 0, 0);
    out.write_all(&[degree, fractional_bits, flags, reserved])?;

    for mean in &gaussians.means {
        for value in y_up(*mean) {
            let steps = value * 2_f32.powi(fractional_bits.into());
            let steps = steps.round().clamp(-MAX_POSITION, MAX_POSITION) as i32;
            out.write_all(&steps.to_le_bytes()[..3])?;
        }
    }
    for i in 0..gaussians.len() {
        out.write_all(&[byte(gaussians.opacity(i))])?;
    }
    for sh in &gaussians.sh {
        out.write_all(&sh.map(|sh| byte(COLOR_SCALE * sh + 0.5)))?;
    }
    for log_scales in &gaussians.log_scales {
        out.write_all(&log_scales.map(|log_scale| (16.0 * (log_scale + 10.0)).round() as u8))?;
    }
    for i in 0..gaussians.len() {
        let [w, x, y, z] = y_up_quat(unit_quat(gaussians, i));
        out.write_all(&packed_rotation([x, y, z, w]).to_le_bytes())?;
    }
    out.finish()?;
    Ok(())
}

/// As many as leave room for the largest coordinate.
fn fractional_bits(gaussians: &Gaussians) -> u8 {
    let coordinates = gaussians.means.as_flattened().iter();
    let largest = coordinates.fold(0.0_f32, |largest, x| largest.max(x.abs()));
    let fits = |bits: &u8| largest * 2_f32.powi((*bits).into()) <= MAX_POSITION;
    (0..=MAX_FRACTIONAL_BITS).rev().find(fits).unwrap_or(0)
}

/// A unit quaternion as the place of its largest component (2 bits) and, in order, sign and magnitude
/// (1 and 9 bits, in units of sqrt(1/2) / 511) of the others. The largest is made positive.
fn packed_rotation(quat: [f32; 4]) -> u32 {
    let largest = index_of_largest(&quat);
    let sign = quat[largest].signum();
    let mut packed = largest as u32;
    for (i, q) in quat.into_iter().enumerate() {
        if i != largest {
            let q = q * sign;
            let magnitude = (511.0 * std::f32::consts::SQRT_2 * q.abs())
                .round()
                .min(511.0);
            packed = packed << 10 | u32::from(q < 0.0) << 9 | magnitude as u32;
        }
    }
    packed
}
