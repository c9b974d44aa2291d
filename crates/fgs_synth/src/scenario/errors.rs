//! How far poses are from the truth.

use fgs_geom::Se3;
use nalgebra::Vector6;

use super::Scenario;

/// A pose's distance from the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseError {
    /// Metres.
    pub position_m: f64,
    /// Radians.
    pub rotation_rad: f64,
}

impl PoseError {
    /// Whether nothing should be built on such a pose: off by more than 5 cm or 3 degrees.
    pub fn is_wrong(&self) -> bool {
        self.position_m > 0.05 || self.rotation_rad > 3f64.to_radians()
    }
}

impl Scenario {
    /// The error of each of the poses that were found, `found_from_camera` frame by frame. The world in
    /// which they were found is aligned with the true one by the frames before the disturbance.
    pub fn errors(&self, poses: &[Option<Se3>]) -> Vec<Option<PoseError>> {
        let found_from_world = |(index, pose): (usize, &Option<Se3>)| {
            pose.map(|pose| pose * self.world_from_camera(index).inverse())
        };
        let before: Vec<Se3> = (poses.iter().take(self.disturbed.start).enumerate())
            .filter_map(found_from_world)
            .collect();
        let first = before.first().copied().unwrap_or_else(Se3::identity);
        let differences = before.iter().map(|other| (first.inverse() * *other).log());
        let mean = differences.sum::<Vector6<f64>>() / before.len().max(1) as f64;
        let found_from_world = first * Se3::exp(&mean);
        let error = |(index, pose): (usize, &Option<Se3>)| {
            let truth = found_from_world * self.world_from_camera(index);
            pose.map(|pose| PoseError {
                position_m: (pose.translation - truth.translation).norm(),
                rotation_rad: pose.rotation.angle_to(&truth.rotation),
            })
        };
        poses.iter().enumerate().map(error).collect()
    }
}
