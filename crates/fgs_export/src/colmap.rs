//! The text files of a COLMAP model. Ids count from 1.

use std::io::{self, Write};

use fgs_geom::{Camera, Intrinsics};

use crate::Point;
use crate::keyframe_images::KeyframeFiles;

/// From our pixel coordinates to COLMAP's, in which the first pixel's centre is at (0.5, 0.5).
const PIXEL_CENTER: f64 = 0.5;

/// `cameras.txt`.
pub(crate) fn write_cameras(out: &mut dyn Write, camera: &Camera) -> io::Result<()> {
    let Camera {
        width,
        height,
        intrinsics: Intrinsics { fx, fy, cx, cy },
    } = camera;
    let (cx, cy) = (cx + PIXEL_CENTER, cy + PIXEL_CENTER);
    writeln!(out, "# CAMERA_ID MODEL WIDTH HEIGHT fx fy cx cy")?;
    writeln!(out, "1 PINHOLE {width} {height} {fx} {fy} {cx} {cy}")
}

/// `images.txt`: a line for each image, followed by an empty one for its points.
pub(crate) fn write_images(out: &mut dyn Write, files: &[KeyframeFiles]) -> io::Result<()> {
    writeln!(out, "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME")?;
    writeln!(out, "# POINTS2D[] as (X Y POINT3D_ID)")?;
    for (i, file) in files.iter().enumerate() {
        let camera_from_world = file.world_from_camera.inverse();
        let (q, t) = (camera_from_world.rotation, camera_from_world.translation);
        let name = file.image.trim_start_matches("images/");
        writeln!(
            out,
            "{} {} {} {} {} {} {} {} 1 {name}\n",
            i + 1,
            q.w,
            q.i,
            q.j,
            q.k,
            t.x,
            t.y,
            t.z
        )?;
    }
    Ok(())
}

/// `points3D.txt`. The error of reprojection is not known: 0.
pub(crate) fn write_points(out: &mut dyn Write, points: &[Point]) -> io::Result<()> {
    writeln!(
        out,
        "# POINT3D_ID X Y Z R G B ERROR TRACK[] as (IMAGE_ID POINT2D_IDX)"
    )?;
    for (i, point) in points.iter().enumerate() {
        let ([x, y, z], [red, green, blue]) = (point.position, point.color);
        writeln!(out, "{} {x} {y} {z} {red} {green} {blue} 0", i + 1)?;
    }
    Ok(())
}
