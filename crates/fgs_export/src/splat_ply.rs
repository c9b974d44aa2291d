//! Gaussians as the PLY file of the original 3D gaussian splatting.
//!
//! Element `vertex` with the float properties `x y z nx ny nz f_dc_0..2 opacity scale_0..2 rot_0..3`:
//! metres, zero normals, spherical harmonics of degree 0, logits, logarithms of metres, wxyz. The
//! values are those of the map, bit for bit, in the run's axes, y down, which is what viewers of this
//! format expect.

use std::io::{self, Write};

use fgs_splat::Gaussians;

use crate::ply::{Element, write_floats, write_header};

const PROPERTIES: [(&str, &str); 17] = [
    ("float", "x"),
    ("float", "y"),
    ("float", "z"),
    ("float", "nx"),
    ("float", "ny"),
    ("float", "nz"),
    ("float", "f_dc_0"),
    ("float", "f_dc_1"),
    ("float", "f_dc_2"),
    ("float", "opacity"),
    ("float", "scale_0"),
    ("float", "scale_1"),
    ("float", "scale_2"),
    ("float", "rot_0"),
    ("float", "rot_1"),
    ("float", "rot_2"),
    ("float", "rot_3"),
];

/// Writes all gaussians.
///
/// # Errors
/// If writing fails.
pub fn write_splat_ply(out: &mut impl Write, gaussians: &Gaussians) -> io::Result<()> {
    let vertices = Element {
        name: "vertex",
        count: gaussians.len(),
        properties: &PROPERTIES,
    };
    write_header(out, &[vertices])?;
    for i in 0..gaussians.len() {
        write_floats(out, &gaussians.means[i])?;
        write_floats(out, &[0.0; 3])?;
        write_floats(out, &gaussians.sh[i])?;
        write_floats(out, &[gaussians.opacity_logits[i]])?;
        write_floats(out, &gaussians.log_scales[i])?;
        write_floats(out, &gaussians.quats[i])?;
    }
    Ok(())
}
