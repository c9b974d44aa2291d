//! Gaussians as binary glTF with the extension `KHR_gaussian_splatting`, as ratified by Khronos.
//!
//! A primitive of points with the attributes `POSITION` and `KHR_gaussian_splatting:ROTATION` (xyzw),
//! `:SCALE` (metres), `:OPACITY` (0 to 1) and `:SH_DEGREE_0_COEF_0`, all floats. Viewers without the
//! extension show points of the colours in `COLOR_0`. Axes of glTF: y up; the first camera looks along
//! -z, as glTF's cameras do; metres.

use std::io::{self, Write};

use fgs_splat::Gaussians;
use serde_json::json;

use crate::glb::Glb;
use crate::quantities::{linear, unit_quat, y_up, y_up_quat};

const EXTENSION: &str = "KHR_gaussian_splatting";
const POINTS: u32 = 0;

/// Writes all gaussians.
///
/// # Errors
/// If writing fails or the file would exceed 4 GiB.
pub fn write_splat_glb(out: &mut impl Write, gaussians: &Gaussians) -> io::Result<()> {
    let all = 0..gaussians.len();
    let mut glb = Glb::default();
    glb.positions(gaussians.means.iter().map(|mean| y_up(*mean)));
    glb.floats(
        &format!("{EXTENSION}:ROTATION"),
        all.clone().map(|i| {
            let [w, x, y, z] = y_up_quat(unit_quat(gaussians, i));
            [x, y, z, w]
        }),
    );
    glb.floats(
        &format!("{EXTENSION}:SCALE"),
        // glTF has no infinity.
        all.clone()
            .map(|i| gaussians.scales(i).map(|scale| scale.min(f32::MAX))),
    );
    glb.floats(
        &format!("{EXTENSION}:OPACITY"),
        all.clone().map(|i| [gaussians.opacity(i)]),
    );
    glb.floats(
        &format!("{EXTENSION}:SH_DEGREE_0_COEF_0"),
        gaussians.sh.iter().copied(),
    );
    glb.floats(
        "COLOR_0",
        all.map(|i| {
            let [red, green, blue] = gaussians.rgb(i).map(linear);
            [red, green, blue, gaussians.opacity(i)]
        }),
    );
    let primitive = json!({
        "mode": POINTS,
        "extensions": {
            EXTENSION: {
                "kernel": "ellipse",
                // Gaussians are optimised to render the camera's sRGB values as they are.
                "colorSpace": "srgb_rec709_display",
                "projection": "perspective",
                "sortingMethod": "cameraDistance",
            }
        }
    });
    glb.write(out, primitive, json!({ "extensionsUsed": [EXTENSION] }))
}
