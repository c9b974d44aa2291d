//! How far poses are from the truth.

use std::collections::BTreeMap;

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

/// A world that is found later is aligned by so many of its first frames.
const ALIGNED_BY: usize = 10;

impl Scenario {
    /// The error of each of the poses that were found, `found_from_camera` frame by frame, with the number of
    /// the world that it was found in. Each world is aligned with the true one by itself: the first, 0, by the
    /// frames before the disturbance, others by their first ten.
    pub fn errors(&self, poses: &[Option<(usize, Se3)>]) -> Vec<Option<PoseError>> {
        let aligned = |world: usize| self.found_from_world(world, poses);
        let worlds: BTreeMap<usize, Se3> = (poses.iter().flatten())
            .map(|(world, _)| (*world, aligned(*world)))
            .collect();
        let error = |(index, found): (usize, &Option<(usize, Se3)>)| {
            let (world, pose) = found.as_ref()?;
            let truth = *worlds.get(world)? * self.world_from_camera(index);
            Some(PoseError {
                position_m: (pose.translation - truth.translation).norm(),
                rotation_rad: pose.rotation.angle_to(&truth.rotation),
            })
        };
        poses.iter().enumerate().map(error).collect()
    }

    fn found_from_world(&self, world: usize, poses: &[Option<(usize, Se3)>]) -> Se3 {
        let frames = if world == 0 {
            self.disturbed.start
        } else {
            poses.len()
        };
        let found = poses.iter().take(frames).enumerate();
        let found_from_world = found.filter_map(|(index, found)| {
            let (of, pose) = found.as_ref()?;
            (*of == world).then(|| *pose * self.world_from_camera(index).inverse())
        });
        let aligned_by = if world == 0 { frames } else { ALIGNED_BY };
        let all: Vec<Se3> = found_from_world.take(aligned_by).collect();
        let first = all.first().copied().unwrap_or_else(Se3::identity);
        let differences = all.iter().map(|other| (first.inverse() * *other).log());
        let mean = differences.sum::<Vector6<f64>>() / all.len().max(1) as f64;
        first * Se3::exp(&mean)
    }
}
