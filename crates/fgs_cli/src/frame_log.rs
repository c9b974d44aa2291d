//! `frames.csv`: what became of each frame, one row a frame.

use std::io::Write;
use std::path::Path;

use anyhow::Context;
use fgs_slam::KeyframeKind;
use serde::{Deserialize, Serialize};

/// What became of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FrameStatus {
    /// It has a pose.
    Tracked,
    /// It was read but has no pose that can be trusted.
    Lost,
    /// It could not be read.
    Damaged,
    /// It came too late in real time.
    Dropped,
}

/// [`KeyframeKind`] as text.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum KeyframeName {
    /// It extended the sparse and the dense map.
    Tracking,
    /// It extended the dense map.
    Mapping,
}

impl From<KeyframeKind> for KeyframeName {
    fn from(kind: KeyframeKind) -> Self {
        match kind {
            KeyframeKind::Tracking => Self::Tracking,
            KeyframeKind::Mapping => Self::Mapping,
        }
    }
}

/// A row. Columns from `psnr_valid_depth_db` on are filled by the evaluation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameRow {
    /// Position in the recording, from 0.
    pub index: usize,
    /// Seconds on the recording's clock.
    pub timestamp_secs: Option<f64>,
    /// What became of it.
    pub status: FrameStatus,
    /// Empty unless it became a keyframe.
    pub keyframe: Option<KeyframeName>,
    /// How many of its points have a surface and were to be registered.
    pub points: Option<usize>,
    /// How many points the sparse map had then.
    pub sparse_points: Option<usize>,
    /// How many of its points correspond to the sparse map.
    pub inliers: Option<usize>,
    /// Root mean square distance of those along the surface normal, metres.
    pub residual_m: Option<f64>,
    /// How well the weakest direction is constrained, 0 to 1.
    pub conditioning: Option<f64>,
    /// Wall time of tracking, milliseconds.
    pub tracking_ms: Option<f64>,
    /// Over pixels with depth.
    pub psnr_valid_depth_db: Option<f64>,
    /// Over all pixels that the camera saw.
    pub psnr_db: Option<f64>,
    /// As the paper's code has it.
    pub psnr_paper_db: Option<f64>,
    /// Structural similarity.
    pub ssim: Option<f64>,
    /// Mean absolute depth error, metres.
    pub depth_l1_m: Option<f64>,
}

impl FrameRow {
    /// A frame of which nothing but its fate is known.
    pub fn without_result(index: usize, status: FrameStatus) -> Self {
        Self {
            index,
            timestamp_secs: None,
            status,
            keyframe: None,
            points: None,
            sparse_points: None,
            inliers: None,
            residual_m: None,
            conditioning: None,
            tracking_ms: None,
            psnr_valid_depth_db: None,
            psnr_db: None,
            psnr_paper_db: None,
            ssim: None,
            depth_l1_m: None,
        }
    }
}

/// Writes a header and the rows.
///
/// # Errors
/// If writing fails.
pub fn write(rows: &[FrameRow], writer: &mut dyn Write) -> anyhow::Result<()> {
    let mut csv = csv::Writer::from_writer(writer);
    for row in rows {
        csv.serialize(row)?;
    }
    Ok(csv.flush()?)
}

/// Reads what [`write`] wrote.
///
/// # Errors
/// If the file cannot be read or a line is not a row; with path and line.
pub fn read(path: &Path) -> anyhow::Result<Vec<FrameRow>> {
    let context = || format!("cannot read {}", path.display());
    let mut csv = csv::Reader::from_path(path).with_context(context)?;
    csv.deserialize()
        .collect::<Result<_, _>>()
        .with_context(context)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read() {
        let mut tracked = FrameRow::without_result(3, FrameStatus::Tracked);
        tracked.timestamp_secs = Some(0.1);
        tracked.keyframe = Some(KeyframeName::Mapping);
        tracked.psnr_db = Some(f64::INFINITY);
        let rows = [tracked, FrameRow::without_result(4, FrameStatus::Damaged)];
        let mut text = Vec::new();
        write(&rows, &mut text).unwrap();
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), &text).unwrap();
        assert_eq!(read(file.path()).unwrap(), rows);
        let damaged = String::from_utf8(text).unwrap().replace("damaged", "tired");
        std::fs::write(file.path(), damaged).unwrap();
        let message = format!("{:#}", read(file.path()).unwrap_err());
        assert!(message.contains("line: 3"), "{message}");
    }
}
