//! A folder of colour images and a folder of depth images, paired in natural order of their names.

use std::path::{Path, PathBuf};

use super::{Recording, frames_at_default_rate, poses};
use crate::DataError;
use crate::natural_order::{is_image_name, sorted_names};

/// The folder of colour images, by the first of its usual names.
pub(super) fn color_folder(folder: &Path) -> Option<PathBuf> {
    ["rgb", "color", "image", "images"]
        .iter()
        .map(|name| folder.join(name))
        .find(|path| path.is_dir())
}

pub(super) fn list(folder: &Path) -> Result<Recording, DataError> {
    let depth_folder = folder.join("depth");
    let color_folder = color_folder(folder).unwrap_or_else(|| folder.join("rgb"));
    let colors = image_files(&color_folder)?;
    let depths = image_files(&depth_folder)?;
    if colors.len() != depths.len() {
        return Err(DataError::CountMismatch {
            path: color_folder,
            count: colors.len(),
            other: depth_folder,
            other_count: depths.len(),
        });
    }
    let frames = frames_at_default_rate(colors.into_iter().zip(depths))?;
    let ground_truth = match poses::read_matrix_per_line(folder, &frames, &color_folder)? {
        None => poses::read_ground_truth(folder, &frames, &color_folder)?,
        known => known,
    };
    Ok(Recording {
        frames,
        ground_truth,
        no_depth: 0,
    })
}

fn image_files(folder: &Path) -> Result<Vec<PathBuf>, DataError> {
    let mut names = sorted_names(folder)?;
    names.retain(|name| is_image_name(name));
    if names.is_empty() {
        return Err(DataError::Empty {
            path: folder.into(),
            what: "PNG or JPEG image",
        });
    }
    Ok(names.iter().map(|name| folder.join(name)).collect())
}
