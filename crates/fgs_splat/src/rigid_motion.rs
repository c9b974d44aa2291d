//! The rigid motion of the gaussians anchored to a keyframe, and what it makes of Adam's moments.
//!
//! A gaussian at `mean` with rotation `quat` goes to `R mean + t` and `r quat`, where `r` is the
//! quaternion of `R`. Both are linear in the parameters, so their derivatives, and with them first
//! moments, go through the same matrices `R` (3x3) and `L`, the left multiplication by `r` (4x4).
//! Second moments go through these matrices with each entry squared.

use std::collections::BTreeMap;

use fgs_geom::{KeyframeId, Se3, View};

use crate::ModelError;

/// One motion by keyframe: those of the same keyframe in turn.
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

/// A view from where the motion takes its camera.
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
