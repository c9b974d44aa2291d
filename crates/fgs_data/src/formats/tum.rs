//! TUM RGB-D: lists of time stamps and files, paired by time.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use fgs_files::{check_regular, is_present};

use super::{FrameFiles, Recording, no_overlap, poses};
use crate::association::associate;
use crate::lines::{Line, Lines};
use crate::{DataError, LineFault};

pub(super) fn list(folder: &Path, max_difference_secs: f64) -> Result<Recording, DataError> {
    let associations = folder.join("associations.txt");
    let color_list = folder.join("rgb.txt");
    let (frames, frames_path) = if is_present(&associations) && !is_present(&color_list) {
        (read_associations(folder, &associations)?, associations)
    } else {
        (
            pair_lists(folder, &color_list, max_difference_secs)?,
            color_list,
        )
    };
    let (ground_truth, pose_origin) = poses::read_trajectory(folder, &frames, &frames_path);
    Ok(Recording {
        ground_truth,
        pose_origin,
        frames,
        no_depth: 0,
    })
}

/// `rgb.txt` and `depth.txt`.
fn pair_lists(
    folder: &Path,
    color_path: &Path,
    max_difference_secs: f64,
) -> Result<Vec<FrameFiles>, DataError> {
    let depth_path = folder.join("depth.txt");
    let (color_secs, colors) = read_list(folder, color_path)?;
    let (depth_secs, depths) = read_list(folder, &depth_path)?;
    let pairs = associate(&color_secs, &depth_secs, max_difference_secs);
    if pairs.is_empty() {
        return Err(no_overlap(
            (color_path, &color_secs),
            (&depth_path, &depth_secs),
        ));
    }
    let frame = |(color, depth): (usize, usize)| FrameFiles {
        timestamp_secs: color_secs[color],
        color: colors[color].clone(),
        depth: depths[depth].clone(),
    };
    Ok(pairs.into_iter().map(frame).collect())
}

/// Lines of `timestamp file`: the times, strictly increasing, and the files.
fn read_list(folder: &Path, path: &Path) -> Result<(Vec<f64>, Vec<PathBuf>), DataError> {
    if !is_present(path) {
        return Err(DataError::MissingList(path.into()));
    }
    let (mut times, mut files) = (Vec::new(), Vec::new());
    let mut lines = Lines::open(path)?;
    while let Some(line) = lines.next_line()? {
        let [time, file] = line.columns()?;
        times.push(later_time(&line, time, times.last())?);
        files.push(existing_file(&line, folder, file)?);
    }
    refuse_empty(path, files.is_empty())?;
    Ok((times, files))
}

/// Lines of `timestamp color_file timestamp depth_file`.
fn read_associations(folder: &Path, path: &Path) -> Result<Vec<FrameFiles>, DataError> {
    let mut frames: Vec<FrameFiles> = Vec::new();
    let mut lines = Lines::open(path)?;
    while let Some(line) = lines.next_line()? {
        let [time, color, depth_time, depth] = line.columns()?;
        line.parse_number(depth_time)?;
        frames.push(FrameFiles {
            timestamp_secs: later_time(&line, time, frames.last().map(|f| &f.timestamp_secs))?,
            color: existing_file(&line, folder, color)?,
            depth: existing_file(&line, folder, depth)?,
        });
    }
    refuse_empty(path, frames.is_empty())?;
    Ok(frames)
}

fn later_time(line: &Line<'_>, column: &str, previous: Option<&f64>) -> Result<f64, DataError> {
    let current = line.parse_number(column)?;
    match previous {
        Some(&previous) if current <= previous => {
            Err(line.error(LineFault::NotIncreasing { previous, current }))
        }
        _ => Ok(current),
    }
}

fn existing_file(line: &Line<'_>, folder: &Path, name: &str) -> Result<PathBuf, DataError> {
    let path = folder.join(name);
    match check_regular(&path) {
        Ok(()) => Ok(path),
        Err(error) if error.kind() == ErrorKind::NotFound => {
            Err(line.error(LineFault::AbsentFile(path)))
        }
        Err(error) => Err(line.error(LineFault::NotAFile {
            path,
            what: error.to_string(),
        })),
    }
}

fn refuse_empty(path: &Path, is_empty: bool) -> Result<(), DataError> {
    if is_empty {
        return Err(DataError::Empty {
            path: path.into(),
            what: "entry",
        });
    }
    Ok(())
}
