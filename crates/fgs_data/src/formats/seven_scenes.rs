//! 7-Scenes: `frame-*.color.png` with `.depth.png` and, where known, `.pose.txt` beside it.

use std::path::Path;

use super::{Recording, frames_at_default_rate, poses};
use crate::natural_order::{is_image_name, sorted_names};
use crate::{DataError, Trajectory};

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
    let mut known = Vec::new();
    for (frame, (_, id)) in frames.iter().zip(ids()) {
        let path = folder.join(format!("{id}.pose.txt"));
        if path.exists() {
            known.push((frame.timestamp_secs, poses::read_matrix(&path)?));
        }
    }
    Ok(Recording {
        ground_truth: (!known.is_empty())
            .then(|| Trajectory::new(known))
            .transpose()?,
        frames,
        no_depth: NO_DEPTH,
    })
}

/// `frame-000012` of `frame-000012.color.png`.
fn frame_id(name: &str) -> Option<&str> {
    let (id, extension) = name.rsplit_once(".color.")?;
    (id.starts_with("frame-") && is_image_name(name) && !extension.contains('.')).then_some(id)
}
