//! Gaussians as the host keeps them, arrays of each parameter, and as the device does, one after
//! the other.

use super::layout::{Gaussian, NONE};
use crate::gaussians::opacity;
use crate::model::{SparseGaussian, SparseId};
use crate::{Gaussians, Seeds};

/// New gaussians, none of which has made a step.
pub fn to_device(seeds: &Seeds) -> Vec<Gaussian> {
    let gaussians = &seeds.gaussians;
    let ids = seeds.sparse_ids.iter().enumerate();
    ids.map(|(i, id)| Gaussian {
        mean: gaussians.means[i],
        opacity_logit: gaussians.opacity_logits[i],
        quat: gaussians.quats[i],
        log_scales: gaussians.log_scales[i],
        steps: 0,
        sh: gaussians.sh[i],
        sparse_id: id.map_or(NONE, |id| id.0),
    })
    .collect()
}

/// What the device holds, in its order.
pub fn from_device(rows: &[Gaussian]) -> Gaussians {
    Gaussians {
        means: rows.iter().map(|row| row.mean).collect(),
        quats: rows.iter().map(|row| row.quat).collect(),
        log_scales: rows.iter().map(|row| row.log_scales).collect(),
        opacity_logits: rows.iter().map(|row| row.opacity_logit).collect(),
        sh: rows.iter().map(|row| row.sh).collect(),
    }
}

/// As the tracker takes them, by ascending id.
pub fn sparse_from_device(rows: &[Gaussian]) -> Vec<SparseGaussian> {
    let mut sparse: Vec<SparseGaussian> = rows
        .iter()
        .map(|row| SparseGaussian {
            id: SparseId(row.sparse_id),
            mean: row.mean,
            quat: row.quat,
            log_scales: row.log_scales,
            opacity: opacity(row.opacity_logit),
        })
        .collect();
    sparse.sort_by_key(|gaussian| gaussian.id);
    sparse
}
