//! Replica as rendered by NICE-SLAM: `results/frame*.jpg` with `results/depth*.png`, and
//! `traj.txt`.

use std::path::Path;

use super::{Recording, frames_at_default_rate, poses};
use crate::natural_order::{is_image_name, sorted_names};
use crate::{DataError, PoseOrigin};

pub(super) fn list(folder: &Path) -> Result<Recording, DataError> {
    let results = folder.join("results");
    let pairs = sorted_names(&results)?.into_iter().filter_map(|name| {
        let (id, _) = name
            .strip_prefix("frame")
            .filter(|_| is_image_name(&name))?
            .rsplit_once('.')?;
        Some((results.join(&name), results.join(format!("depth{id}.png"))))
    });
    let frames = frames_at_default_rate(pairs)?;
    if frames.is_empty() {
        return Err(DataError::Empty {
            path: results,
            what: "image frame*.jpg or frame*.png",
        });
    }
    Ok(Recording {
        ground_truth: poses::read_matrix_per_line(folder, &frames, &results),
        pose_origin: PoseOrigin::GroundTruth,
        frames,
        no_depth: 0,
    })
}
