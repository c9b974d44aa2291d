//! A point with the covariance of the surface patch that it represents.

use fgs_geom::Se3;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::Covariance;

/// A source or target point of a registration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// Metres. `f32` rounds to 1 um at 10 m, well below the resolution of any depth sensor.
    pub position: Vector3<f32>,
    /// Covariance of the surface patch, in the same frame as the position.
    pub covariance: Covariance,
}

impl Point {
    /// The same patch, expressed in frame `a`.
    pub fn transformed(&self, a_from_b: &Se3) -> Self {
        let rotation = a_from_b.rotation.to_rotation_matrix().into_inner();
        Self {
            position: a_from_b.transform(&self.position.cast()).cast(),
            covariance: self.covariance.rotated(&rotation),
        }
    }

    /// Whether the position and covariance are finite.
    pub fn is_finite(&self) -> bool {
        self.position.iter().all(|value| value.is_finite()) && self.covariance.is_finite()
    }
}
