//! Turns maps and poses from the first camera's axes into level ones.

use fgs_geom::Se3;
use fgs_splat::Gaussians;
use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

use crate::quantities::unit_quat;

/// A turn to level axes of the same origin: x right, y down, z to where the first camera looks.
#[derive(Clone, Copy, Debug)]
pub struct Level {
    /// `level_from_run`.
    rotation: UnitQuaternion<f64>,
}

impl Level {
    /// For a run whose [upward direction](crate::up_direction) is `up`, of length 1.
    pub fn new(up: Vector3<f64>) -> Self {
        let down = -up;
        // Ahead of a camera that looks straight down is its image's top, of one that looks up the bottom.
        let ahead = Vector3::z() - down * down.z;
        let ahead = if ahead.norm() > 0.1 {
            ahead.normalize()
        } else {
            (down * down.y - Vector3::y()).normalize() * down.z.signum()
        };
        let rows = [down.cross(&ahead), down, ahead].map(|axis| axis.transpose());
        let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_rows(&rows));
        Self {
            rotation: UnitQuaternion::from_rotation_matrix(&rotation),
        }
    }

    /// A pose `world_from_camera` in the level world.
    pub fn pose(&self, world_from_camera: &Se3) -> Se3 {
        Se3::new(self.rotation, Vector3::zeros()) * *world_from_camera
    }

    /// A map in the level world.
    pub fn map(&self, gaussians: &Gaussians) -> Gaussians {
        let mut level = gaussians.clone();
        for (i, (mean, quat)) in level.means.iter_mut().zip(&mut level.quats).enumerate() {
            let turned = self.rotation * Vector3::from(*mean).cast::<f64>();
            *mean = turned.cast::<f32>().into();
            let [w, x, y, z] = unit_quat(gaussians, i).map(f64::from);
            let turned = self.rotation.quaternion() * Quaternion::new(w, x, y, z);
            *quat = [turned.w, turned.i, turned.j, turned.k].map(|q| q as f32);
        }
        level
    }
}

#[cfg(test)]
mod tests {
    use fgs_splat::Gaussian;

    use super::*;

    #[test]
    fn up_becomes_minus_y_and_the_first_camera_looks_along_z() {
        for up in [
            Vector3::new(0.1, -0.9, -0.3),
            Vector3::new(-0.7, -0.7, 0.0),
            // It looks straight down, and straight up.
            Vector3::new(0.0, 0.0, -1.0),
            Vector3::new(0.0, 0.0, 1.0),
        ] {
            let up = up.normalize();
            let level = Level::new(up);
            assert!((level.rotation * up + Vector3::y()).norm() < 1e-12);
            let ahead = level.rotation * Vector3::z();
            assert!(ahead.x.abs() < 1e-12 && ahead.z > -1e-12, "{ahead}");
            assert!((level.rotation * Vector3::x()).x > 0.5);
            let pose = level.pose(&Se3::identity());
            assert!(pose.rotation.angle_to(&level.rotation) < 1e-12);
        }
        assert!(Level::new(-Vector3::y()).rotation.angle() < 1e-12);
    }

    #[test]
    fn a_gaussian_turns_with_its_place() {
        let mut map = Gaussians::default();
        map.push(&Gaussian {
            mean: [1.0, 2.0, 3.0],
            quat: [1.0, 0.0, 0.0, 0.0],
            scales: [0.1, 0.2, 0.3],
            opacity: 0.5,
            rgb: [0.5; 3],
        });
        let up = Vector3::new(0.3, -0.8, 0.2).normalize();
        let level = Level::new(up);
        let turned = level.map(&map);
        let height =
            |map: &Gaussians, up: Vector3<f64>| up.dot(&Vector3::from(map.means[0]).cast());
        assert!((height(&map, up) - height(&turned, -Vector3::y())).abs() < 1e-6);
        let [w, x, y, z] = turned.quats[0].map(f64::from);
        let quat = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        assert!(quat.angle_to(&level.rotation) < 1e-6);
        assert_eq!(turned.log_scales, map.log_scales);
    }
}
