//! A folder of colour images and a folder of depth images, paired in natural order of their names.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use super::{Recording, frames_at_default_rate, poses};
use crate::natural_order::{is_image_name, sorted_names};
use crate::{DataError, PoseOrigin};

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
    check_numbers((&color_folder, &colors), (&depth_folder, &depths))?;
    if colors.len() != depths.len() {
        return Err(DataError::CountMismatch {
            path: color_folder,
            count: colors.len(),
            other: depth_folder,
            other_count: depths.len(),
        });
    }
    let frames = frames_at_default_rate(colors.into_iter().zip(depths))?;
    let (ground_truth, pose_origin) =
        match poses::read_matrix_per_line(folder, &frames, &color_folder) {
            Ok(None) => poses::read_trajectory(folder, &frames, &color_folder),
            known => (known, PoseOrigin::GroundTruth),
        };
    Ok(Recording {
        frames,
        ground_truth,
        pose_origin,
        no_depth: 0,
    })
}

/// Where all names carry a frame's number, those of colour and depth must agree: an image that is
/// missing would pair all after it wrongly.
fn check_numbers(
    (color_folder, colors): (&Path, &[PathBuf]),
    (depth_folder, depths): (&Path, &[PathBuf]),
) -> Result<(), DataError> {
    let numbers = |images: &[PathBuf]| -> Option<Vec<String>> {
        images.iter().map(|image| frame_number(image)).collect()
    };
    let (Some(of_colors), Some(of_depths)) = (numbers(colors), numbers(depths)) else {
        return Ok(());
    };
    let lonely = |numbers: &[String], others: &[String], images: &[PathBuf], folder: &Path| {
        let others: HashSet<&String> = others.iter().collect();
        let place = numbers.iter().position(|number| !others.contains(number))?;
        Some(DataError::NoPartner {
            image: images[place].clone(),
            folder: folder.into(),
        })
    };
    lonely(&of_colors, &of_depths, colors, depth_folder)
        .or_else(|| lonely(&of_depths, &of_colors, depths, color_folder))
        .map_or(Ok(()), Err)
}

/// The number that a file name ends with, without leading zeros. A name that is a time has none: two
/// sensors have their own times.
fn frame_number(image: &Path) -> Option<String> {
    let stem = image.file_stem()?.to_str()?;
    let start = stem.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    if start == stem.len() || stem[..start].ends_with('.') {
        return None;
    }
    let number = stem[start..].trim_start_matches('0');
    Some(number.to_owned())
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
