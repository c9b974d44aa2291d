//! The rigid motion of the gaussians anchored to a keyframe, and its effect on Adam's moments.
//!
//! A gaussian's `mean` and `quat` become `R mean + t` and `r quat`, with `r` the quaternion of `R`.
//! Both are linear with orthogonal matrices: `R` (3x3) and `L`, left multiplication by `r` (4x4). So
//! gradients, and with them Adam's first moments, transform by the same matrices. Second moments
//! transform by the matrices with each entry squared.

use std::collections::BTreeMap;

use fgs_geom::{KeyframeId, Se3, View};

use crate::ModelError;

/// One motion per keyframe; several motions of a keyframe are composed in turn.
///
/// # Errors
/// If one is not finite in single precision.
pub(crate) fn by_keyframe(
    moves: &[(KeyframeId, Se3)],
) -> Result<BTreeMap<KeyframeId, Se3>, ModelError> {
    let mut motions = BTreeMap::new();
    for (id, motion) in moves {
        let motion = match motions.get(id) {
            Some(before) => *motion * *before,
            None => *motion,
        };
        if !motion.matrix().iter().all(|x| (*x as f32).is_finite()) {
            return Err(ModelError::NotFinite(*id));
        }
        motions.insert(*id, motion);
    }
    Ok(motions)
}

/// The view after its camera has been moved.
pub(crate) fn moved(view: &View, motion: &Se3) -> View {
    View {
        world_from_camera: (*motion * view.world_from_camera).renormalized(),
        ..*view
    }
}

/// A motion as its matrices.
pub(crate) struct RigidMotion {
    /// `R`, by rows.
    pub rotation: [[f64; 3]; 3],
    /// `L`, by rows: the quaternion `r q` is `L q`, both wxyz.
    pub left: [[f64; 4]; 4],
    /// `t`, metres.
    pub translation: [f64; 3],
}

impl From<&Se3> for RigidMotion {
    fn from(motion: &Se3) -> Self {
        let matrix = motion.rotation.to_rotation_matrix();
        let quat = motion.rotation.quaternion();
        let [w, x, y, z] = [quat.w, quat.i, quat.j, quat.k];
        Self {
            rotation: std::array::from_fn(|i| std::array::from_fn(|j| matrix[(i, j)])),
            left: [[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]],
            translation: motion.translation.into(),
        }
    }
}

impl RigidMotion {
    /// `R point + t`, computed in double precision.
    pub fn apply(&self, point: &[f32; 3]) -> [f32; 3] {
        std::array::from_fn(|i| {
            let turned = (0..3).map(|j| self.rotation[i][j] * f64::from(point[j]));
            (turned.sum::<f64>() + self.translation[i]) as f32
        })
    }
}

/// `matrix * v`, computed in double precision.
pub(crate) fn transformed<const N: usize>(matrix: &[[f64; N]; N], v: &[f32; N]) -> [f32; N] {
    std::array::from_fn(|i| (0..N).map(|j| matrix[i][j] * f64::from(v[j])).sum::<f64>() as f32)
}

/// `matrix` with each entry squared.
pub(crate) fn squared<const N: usize>(matrix: &[[f64; N]; N]) -> [[f64; N]; N] {
    matrix.map(|row| row.map(|x| x * x))
}
