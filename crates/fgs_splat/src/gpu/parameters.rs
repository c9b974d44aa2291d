//! Conversions between the host's structure of arrays and the device's array of structures.

use std::collections::BTreeMap;

use fgs_geom::{KeyframeId, Se3};

use super::layout::{Gaussian, INFERRED, Motion, NONE};
use crate::adam::ByParameter;
use crate::rigid_motion::RigidMotion;
use crate::{Gaussians, Seeds, SparseId};

/// New gaussians, with a step count of zero.
pub fn to_device(seeds: &Seeds) -> Vec<Gaussian> {
    let gaussians = &seeds.gaussians;
    let ids = seeds.sparse_ids.iter().zip(&gaussians.inferred).enumerate();
    ids.map(|(i, (id, inferred))| Gaussian {
        mean: gaussians.means[i],
        opacity_logit: gaussians.opacity_logits[i],
        quat: gaussians.quats[i],
        log_scales: gaussians.log_scales[i],
        steps: 0,
        sh: gaussians.sh[i],
        sparse_id: match id {
            Some(id) => id.0,
            None if *inferred => INFERRED,
            None => NONE,
        },
    })
    .collect()
}

/// The device's gaussians, in the same order.
pub fn from_device(rows: &[Gaussian]) -> Gaussians {
    Gaussians {
        means: rows.iter().map(|row| row.mean).collect(),
        quats: rows.iter().map(|row| row.quat).collect(),
        log_scales: rows.iter().map(|row| row.log_scales).collect(),
        opacity_logits: rows.iter().map(|row| row.opacity_logit).collect(),
        sh: rows.iter().map(|row| row.sh).collect(),
        inferred: rows.iter().map(|row| row.sparse_id == INFERRED).collect(),
    }
}

/// The ids of those of the device's gaussians that are part of the sparse map.
pub fn sparse_ids_from_device(rows: &[Gaussian]) -> Vec<Option<SparseId>> {
    let id = |row: &Gaussian| {
        (![NONE, INFERRED].contains(&row.sparse_id)).then_some(SparseId(row.sparse_id))
    };
    rows.iter().map(id).collect()
}

/// Adam's moments in the order of the device's gradients.
pub fn moments_to_device(moments: &ByParameter) -> [f32; 16] {
    let [x, y, z, qw, qx, qy, qz, s0, s1, s2, opacity, r, g, b, ..] = moments.0;
    [
        x, y, z, opacity, qw, qx, qy, qz, s0, s1, s2, 0.0, r, g, b, 0.0,
    ]
}

/// The inverse of [`moments_to_device`].
pub fn moments_from_device(moments: &[f32; 16]) -> ByParameter {
    let [x, y, z, opacity, qw, qx, qy, qz, s0, s1, s2, _, r, g, b, _] = *moments;
    ByParameter([
        x, y, z, qw, qx, qy, qz, s0, s1, s2, opacity, r, g, b, 0.0, 0.0,
    ])
}

/// Motions for the device, sorted by anchor.
pub fn motions_to_device(motions: &BTreeMap<KeyframeId, Se3>) -> Vec<Motion> {
    let motions = motions.iter();
    motions
        .map(|(id, motion)| {
            let RigidMotion {
                rotation,
                left,
                translation,
            } = RigidMotion::from(motion);
            let [row_x, row_y, row_z] = rotation.map(|row| row.map(|x| x as f32));
            Motion {
                row_x,
                anchor: id.0,
                row_y,
                row_z,
                translation: translation.map(|x| x as f32),
                // The first column of `left` is the quaternion itself.
                quat: left.map(|row| row[0] as f32),
                ..Motion::default()
            }
        })
        .collect()
}
