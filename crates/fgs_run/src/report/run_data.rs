//! What a page tells of a run, as read from its folder.

use std::path::{Path, PathBuf};

use fgs_data::Trajectory;

use crate::error::RunError;
use crate::frame_log::{self, FrameRow};
use crate::metrics::Metrics;
use crate::run_folder::{CONFIG, FRAMES, PICTURES, REFERENCE, RunFolder, TRAJECTORY};
use crate::settings::Settings;

/// A year at 30 frames a second. Larger ones come from damaged files, and no axis can show them.
const MAX_INDEX: usize = 1_000_000_000;

/// A place in the run's world, metres: x right, y down, z forward of the first camera.
pub type Position = [f64; 3];

/// A run.
pub struct RunData {
    /// The folder's name.
    pub name: String,
    pub metrics: Metrics,
    pub settings: Settings,
    /// One for each frame.
    pub rows: Vec<FrameRow>,
    /// Where each frame was, if it has a pose.
    pub positions: Vec<Option<Position>>,
    /// Where each frame really was, if that is known.
    pub reference: Vec<Option<Position>>,
    /// The folder with the pictures.
    pub pictures: PathBuf,
}

impl RunData {
    /// Reads a run's folder.
    ///
    /// # Errors
    /// If a result is missing or damaged.
    pub fn read(folder: &RunFolder) -> Result<Self, RunError> {
        let mut rows = frame_log::read(&folder.join(FRAMES))?;
        rows.retain(|row| row.index <= MAX_INDEX);
        let trajectory = Trajectory::read(&folder.join(TRAJECTORY))?;
        let reference = folder.join(REFERENCE);
        let reference = if reference.is_file() {
            Trajectory::read(&reference)?
        } else {
            Trajectory::default()
        };
        Ok(Self {
            name: file_name(folder.path()),
            metrics: Metrics::read(folder)?,
            settings: Settings::read(&folder.join(CONFIG))?,
            positions: at_rows(&trajectory, &rows),
            reference: at_rows(&reference, &rows),
            rows,
            pictures: folder.join(PICTURES),
        })
    }

    /// The name of the recording, without the folders that it lies in.
    pub fn recording(&self) -> String {
        file_name(&self.metrics.dataset)
    }

    /// Whether it is known where the camera really was.
    pub fn has_reference(&self) -> bool {
        self.reference.iter().any(Option::is_some)
    }

    /// How far a frame's position is off, metres.
    pub fn position_error_m(&self, place: usize) -> Option<f64> {
        let (a, b) = (self.positions[place]?, self.reference[place]?);
        let squares = a.iter().zip(b).map(|(a, b)| (a - b).powi(2));
        Some(squares.sum::<f64>().sqrt())
    }

    /// Frames that were tracked or tried to be.
    pub fn frames_tried(&self) -> usize {
        let tried = |row: &&FrameRow| row.tracking_ms.is_some();
        self.rows.iter().filter(tried).count()
    }
}

/// The last part of a path, also for paths such as `.`.
pub fn file_name(path: &Path) -> String {
    let named = |path: &Path| Some(path.file_name()?.to_string_lossy().into_owned());
    named(path)
        .or_else(|| named(&path.canonicalize().ok()?))
        .unwrap_or_else(|| "run".into())
}

fn at_rows(trajectory: &Trajectory, rows: &[FrameRow]) -> Vec<Option<Position>> {
    rows.iter()
        .map(|row| Some(trajectory.at(row.timestamp_secs?)?.translation.into()))
        .collect()
}
