//! nerfstudio's `transforms.json`.

use std::io::{self, Write};

use fgs_geom::{Camera, Intrinsics};
use nalgebra::{Matrix4, Vector4};
use serde_json::{Value, json};

use crate::keyframe_images::KeyframeFiles;

/// Name of the file with points, which begin the optimisation of gaussians.
pub(crate) const POINTS: &str = "points.ply";

/// As in COLMAP, the first pixel's centre is at (0.5, 0.5).
const PIXEL_CENTER: f64 = 0.5;

/// Writes the file.
pub(crate) fn write_transforms(
    out: &mut dyn Write,
    camera: &Camera,
    files: &[KeyframeFiles],
) -> io::Result<()> {
    let Intrinsics { fx, fy, cx, cy } = camera.intrinsics;
    let frames: Vec<Value> = files.iter().map(frame).collect();
    let transforms = json!({
        "camera_model": "OPENCV",
        "w": camera.width,
        "h": camera.height,
        "fl_x": fx,
        "fl_y": fy,
        "cx": cx + PIXEL_CENTER,
        "cy": cy + PIXEL_CENTER,
        "ply_file_path": POINTS,
        "frames": frames,
    });
    serde_json::to_writer_pretty(&mut *out, &transforms)?;
    writeln!(out)
}

fn frame(files: &KeyframeFiles) -> Value {
    let down_from_up = Matrix4::from_diagonal(&Vector4::new(1.0, -1.0, -1.0, 1.0));
    let pose = files.world_from_camera.matrix() * down_from_up;
    let rows = pose.row_iter().map(|row| row.iter().copied().collect());
    let rows: Vec<Vec<f64>> = rows.collect();
    let mut frame = json!({ "file_path": files.image, "transform_matrix": rows });
    if let Some(mask) = &files.mask {
        frame["mask_path"] = json!(mask);
    }
    frame
}
