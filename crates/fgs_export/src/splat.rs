//! Gaussians as a `.splat` file, the format of antimatter15's viewer.
//!
//! 32 bytes a gaussian, without a header: position and scales as six floats (metres), RGB and opacity
//! as four bytes, the rotation wxyz as four bytes `128 + 128 q`. The most visible gaussians come first,
//! by volume times opacity, so that a viewer has something to show while it loads. The run's axes, y
//! down.

use std::io::{self, Write};

use fgs_splat::Gaussians;

use crate::quantities::{byte, unit_quat};

/// Writes all gaussians.
///
/// # Errors
/// If writing fails.
pub fn write_splat(out: &mut impl Write, gaussians: &Gaussians) -> io::Result<()> {
    let visibility = |i: usize| {
        let log_volume: f32 = gaussians.log_scales[i].iter().sum();
        log_volume + gaussians.opacity(i).ln()
    };
    let mut order: Vec<usize> = (0..gaussians.len()).collect();
    order.sort_by(|a, b| visibility(*b).total_cmp(&visibility(*a)));
    order
        .into_iter()
        .try_for_each(|i| out.write_all(&splat_record(gaussians, i)))
}

/// The 32 bytes of gaussian i.
pub fn splat_record(gaussians: &Gaussians, i: usize) -> [u8; 32] {
    let mut record = [0; 32];
    let lengths = gaussians.means[i].into_iter().chain(gaussians.scales(i));
    for (bytes, length) in record.chunks_exact_mut(4).zip(lengths) {
        bytes.copy_from_slice(&length.to_le_bytes());
    }
    let [red, green, blue] = gaussians.rgb(i).map(byte);
    record[24..28].copy_from_slice(&[red, green, blue, byte(gaussians.opacity(i))]);
    let quat = unit_quat(gaussians, i).map(|q| (128.0 + 128.0 * q).round() as u8);
    record[28..].copy_from_slice(&quat);
    record
}
