//! Trajectories in KITTI's format.

use std::io::{self, Write};

use fgs_data::Trajectory;

/// Writes a line for each pose: the upper three rows of the matrix `world_from_camera`, row by row,
/// metres. The format has no time stamps: line i is the i-th pose of the trajectory.
///
/// # Errors
/// If writing fails.
pub fn write_kitti(out: &mut impl Write, trajectory: &Trajectory) -> io::Result<()> {
    for pose in trajectory.poses() {
        let matrix = pose.world_from_camera.matrix();
        let rows = matrix.fixed_rows::<3>(0).transpose();
        let numbers: Vec<String> = rows.iter().map(ToString::to_string).collect();
        writeln!(out, "{}", numbers.join(" "))?;
    }
    Ok(())
}
