//! `frames.csv`: what became of each frame, one row a frame.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::Path;

use fgs_data::plain_words;
use fgs_files::{BYTE_ORDER_MARK, is_utf16, open_regular};
use fgs_slam::{FrameStatus, KeyframeKind};
use serde::{Deserialize, Serialize};

use crate::error::RunError;
use crate::score_values::Scores;
use crate::scores::{SCORES, Source};

/// Nine hours at 30 frames a second; half a gigabyte in memory.
const MAX_ROWS: usize = 1_000_000;
/// What so many rows take at most.
const MAX_BYTES: u64 = 256 << 20;

/// A frame of a run. What is not known or does not apply is `None`, an empty field in the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameRow {
    /// Position in the recording, from 0.
    pub index: usize,
    /// Seconds on the recording's clock.
    pub timestamp_secs: Option<f64>,
    /// What became of it.
    pub status: FrameStatus,
    /// The sub-map that its pose is in, from 0, the largest; while the run goes on as they began.
    pub submap: Option<usize>,
    /// The kind of keyframe it became, if any.
    pub keyframe: Option<KeyframeKind>,
    /// Points sampled from its depth that lie on a surface and were registered.
    pub points: Option<usize>,
    /// Points in the sparse map at that time.
    pub sparse_points: Option<usize>,
    /// Points with a correspondence in the sparse map.
    pub inliers: Option<usize>,
    /// Root mean square point-to-plane distance of the inliers, metres.
    pub residual_m: Option<f64>,
    /// Standard deviation of the position, along its worst direction, by depth and colour alone, metres.
    pub uncertainty_m: Option<f64>,
    /// How much it looks like a keyframe where both see the same, up to 1.
    pub likeness: Option<f64>,
    /// Share of a keyframe's points that it sees through: it measures more depth there.
    pub seen_through: Option<f64>,
    /// Share of the image that was left out because it moves.
    pub moving_share: Option<f64>,
    /// Wall-clock time of tracking, milliseconds.
    pub tracking_ms: Option<f64>,
    /// How well the map shows it: the last columns.
    #[serde(skip)]
    pub scores: Scores,
}

/// The columns before the scores, named as the fields of [`FrameRow`] and in their order.
const COLUMNS: [&str; 14] = [
    "index",
    "timestamp_secs",
    "status",
    "submap",
    "keyframe",
    "points",
    "sparse_points",
    "inliers",
    "residual_m",
    "uncertainty_m",
    "likeness",
    "seen_through",
    "moving_share",
    "tracking_ms",
];

impl FrameRow {
    /// A frame of which nothing else is known.
    pub fn new(index: usize, status: FrameStatus) -> Self {
        Self {
            index,
            timestamp_secs: None,
            status,
            submap: None,
            keyframe: None,
            points: None,
            sparse_points: None,
            inliers: None,
            residual_m: None,
            uncertainty_m: None,
            likeness: None,
            seen_through: None,
            moving_share: None,
            tracking_ms: None,
            scores: Scores::default(),
        }
    }
}

/// Writes a header and the rows.
///
/// # Errors
/// If writing fails.
pub fn write(rows: &[FrameRow], writer: impl Write) -> io::Result<()> {
    let is_column = |source: &Source| matches!(source, Source::Frame(_));
    let scores = SCORES.iter().filter(|score| is_column(&score.source));
    let mut csv = csv::WriterBuilder::new()
        .has_headers(false)
        .from_writer(writer);
    csv.write_record(COLUMNS.into_iter().chain(scores.map(|score| score.name)))?;
    for row in rows {
        let scores = row.scores.iter();
        let scores = scores.filter(|(score, _)| is_column(&score.source));
        let scores: Vec<Option<f64>> = scores.map(|(_, value)| value).collect();
        csv.serialize((row, scores))?;
    }
    csv.flush()
}

/// Reads what [`write`] wrote. Columns are found by name; unknown ones are skipped.
///
/// # Errors
/// If the file cannot be read or a line is not a row; with path and line.
pub fn read(path: &Path) -> Result<Vec<FrameRow>, RunError> {
    let rows = || -> csv::Result<Vec<FrameRow>> {
        let mut csv = csv::Reader::from_reader(open(path)?);
        let header = csv.headers()?.clone();
        csv.records()
            .take(MAX_ROWS + 1)
            .map(|record| {
                let record = record?;
                let mut row: FrameRow = record.deserialize(Some(&header))?;
                row.scores = record.deserialize(Some(&header))?;
                Ok(row)
            })
            .collect()
    };
    let error = |source| RunError::Read {
        path: path.into(),
        source,
    };
    let rows = rows().map_err(|source| {
        let message = plain_words(&source.to_string());
        error(match source.into_kind() {
            csv::ErrorKind::Io(error) => error,
            _ => io::Error::new(io::ErrorKind::InvalidData, message),
        })
    })?;
    if rows.len() > MAX_ROWS {
        let what = format!("holds more than {MAX_ROWS} frames");
        return Err(error(io::Error::new(io::ErrorKind::InvalidInput, what)));
    }
    for pair in rows.windows(2) {
        let (first, second) = (pair[0].index, pair[1].index);
        if first.checked_add(1) != Some(second) {
            let what = format!("frame {second} follows frame {first}");
            return Err(error(io::Error::new(io::ErrorKind::InvalidData, what)));
        }
    }
    Ok(rows)
}

/// The file without a byte order mark, if it is one of a size that a run can have written.
fn open(path: &Path) -> io::Result<impl Read> {
    let file = open_regular(path)?;
    let refuse = |what: String| Err(io::Error::new(io::ErrorKind::InvalidInput, what));
    if file.metadata()?.len() > MAX_BYTES {
        return refuse(format!("is longer than {MAX_BYTES} bytes"));
    }
    let mut reader = BufReader::new(file.take(MAX_BYTES));
    let start = reader.fill_buf()?;
    if is_utf16(start) {
        return refuse("is UTF-16 text: save it as UTF-8".into());
    }
    if start.starts_with(BYTE_ORDER_MARK) {
        reader.consume(BYTE_ORDER_MARK.len());
    }
    Ok(reader)
}

#[cfg(test)]
mod tests {
    use fgs_eval::ImageQuality;

    use super::*;
    use crate::scores::FrameErrors;

    #[test]
    fn what_is_written_is_read() {
        let mut tracked = FrameRow::new(3, FrameStatus::Tracked);
        tracked.timestamp_secs = Some(0.1);
        tracked.submap = Some(1);
        tracked.keyframe = Some(KeyframeKind::Mapping);
        tracked.points = Some(1);
        tracked.sparse_points = Some(2);
        tracked.inliers = Some(3);
        tracked.residual_m = Some(0.25);
        tracked.uncertainty_m = Some(0.5);
        tracked.likeness = Some(0.9);
        tracked.seen_through = Some(0.125);
        tracked.moving_share = Some(0.0625);
        tracked.tracking_ms = Some(7.0);
        tracked.scores = Scores::of_frame(&FrameErrors {
            image: ImageQuality {
                psnr_valid_depth_db: None,
                psnr_db: f64::INFINITY,
                psnr_paper_db: 20.0,
                psnr_exposure_valid_depth_db: None,
                psnr_exposure_db: 21.0,
                ssim: 0.75,
            },
            depth: None,
        });
        let rows = [tracked, FrameRow::new(4, FrameStatus::Damaged)];
        let mut text = Vec::new();
        write(&rows, &mut text).unwrap();
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), &text).unwrap();
        assert_eq!(read(file.path()).unwrap(), rows);
        let damaged = String::from_utf8(text).unwrap().replace("damaged", "tired");
        std::fs::write(file.path(), damaged).unwrap();
        let message = read(file.path()).unwrap_err().to_string();
        assert!(message.contains("line: 3"), "{message}");
        let huge = format!("index,status\n{0},tracked\n{0},tracked\n", usize::MAX);
        std::fs::write(file.path(), huge).unwrap();
        let message = read(file.path()).unwrap_err().to_string();
        assert!(message.contains("follows frame"), "{message}");
    }

    /// Users' scripts read these names, in this order.
    #[test]
    fn columns_keep_their_names_and_order() {
        let mut text = Vec::new();
        write(&[], &mut text).unwrap();
        assert_eq!(
            String::from_utf8(text).unwrap(),
            "index,timestamp_secs,status,submap,keyframe,points,sparse_points,inliers,residual_m,\
             uncertainty_m,likeness,seen_through,moving_share,tracking_ms,psnr_valid_depth_db,psnr_db,psnr_paper_db,\
             psnr_exposure_valid_depth_db,psnr_exposure_db,ssim,depth_l1_m\n"
        );
    }
}
