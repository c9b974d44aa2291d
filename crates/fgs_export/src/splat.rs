//! Gaussians as a `.splat` file, the format of antimatter15's viewer.
//!
//! 32 bytes a gaussian, without a header: position and scales as six floats (metres), RGB and opacity
//! as four bytes, the rotation wxyz as four bytes `128 + 128 q`. The most visible gaussians come first,
//! by volume times opacity, so that a viewer has something to show while it loads. The run's axes, y
//! down.

use std::io::{self, Write};

use fgs_splat::Gaussians;

use crate::ply::write_floats;
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
    for i in order {
        let [red, green, blue] = gaussians.rgb(i).map(byte);
        let quat = unit_quat(gaussians, i).map(|q| (128.0 + 128.0 * q).round() as u8);
        write_floats(out, &gaussians.means[i])?;
        write_floats(out, &gaussians.scales(i))?;
        out.write_all(&[red, green, blue, byte(gaussians.opacity(i))])?;
        out.write_all(&quat)?;
    }
    Ok(())
}
