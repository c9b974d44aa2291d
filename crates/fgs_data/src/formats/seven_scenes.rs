//! 7-Scenes: `frame-*.color.png` with `.depth.png` and, where known, `.pose.txt` beside it.

use std::path::Path;

use fgs_files::is_present;

use super::{FrameFiles, Recording, frames_at_default_rate, poses};
use crate::natural_order::{is_image_name, sorted_names};
use crate::{DataError, PoseOrigin, Trajectory};

/// The sensor's mark for "no measurement".
const NO_DEPTH: u16 = 65535;

pub(super) fn is_laid_out_so(folder: &Path) -> Result<bool, DataError> {
    Ok(sorted_names(folder)?
        .iter()
        .any(|name| frame_id(name).is_some()))
}

pub(super) fn list(folder: &Path) -> Result<Recording, DataError> {
    let names = sorted_names(folder)?;
    let ids = || {
        names
            .iter()
            .filter_map(|name| Some((name, frame_id(name)?)))
    };
    let frames = frames_at_default_rate(
        ids().map(|(name, id)| (folder.join(name), folder.join(format!("{id}.depth.png")))),
    )?;
    let ground_truth = read_poses(folder, &frames, ids().map(|(_, id)| id));
    Ok(Recording {
        ground_truth,
        pose_origin: PoseOrigin::GroundTruth,
        frames,
        no_depth: NO_DEPTH,
    })
}

/// The poses of the frames with these names, as far as there are any.
fn read_poses<'a>(
    folder: &Path,
    frames: &[FrameFiles],
    ids: impl Iterator<Item = &'a str>,
) -> Result<Option<Trajectory>, DataError> {
    let mut known = Vec::new();
    for (frame, id) in frames.iter().zip(ids) {
        let path = folder.join(format!("{id}.pose.txt"));
        if is_present(&path) {
            known.push((frame.timestamp_secs, poses::read_matrix(&path)?));
        }
    }
    (!known.is_empty())
        .then(|| Trajectory::new(known))
        .transpose()
}

/// `frame-000012` of `frame-000012.color.png`.
fn frame_id(name: &str) -> Option<&str> {
    let (id, extension) = name.rsplit_once(".color.")?;
    (id.starts_with("frame-") && is_image_name(name) && !extension.contains('.')).then_some(id)
}
