//! What a run leaves: in memory, and in its folder.

use fgs_data::Trajectory;
use fgs_geom::Se3;
use fgs_splat::Gaussians;

use crate::error::RunError;
use crate::frame_log::{self, FrameRow};
use crate::metrics::Metrics;
use crate::run_folder::{FRAMES, MAP, RunFolder, TRAJECTORY};

/// A run's results.
#[derive(Debug)]
pub struct RunResult {
    /// One row for each frame, of successive frames.
    pub rows: Vec<FrameRow>,
    /// The poses of the tracked frames, `world_from_camera`.
    pub trajectory: Trajectory,
    /// The map.
    pub gaussians: Gaussians,
    /// The numbers.
    pub metrics: Metrics,
}

impl RunResult {
    /// Reads what a run has saved.
    ///
    /// # Errors
    /// If a file is missing or damaged.
    pub fn read(folder: &RunFolder) -> Result<Self, RunError> {
        Ok(Self {
            metrics: Metrics::read(folder)?,
            rows: frame_log::read(&folder.join(FRAMES))?,
            trajectory: Trajectory::read(&folder.join(TRAJECTORY))?,
            gaussians: fgs_splat::read_ply(&folder.join(MAP))?,
        })
    }

    /// A frame's pose `world_from_camera`, if it has one.
    pub fn pose(&self, row: &FrameRow) -> Option<Se3> {
        self.trajectory.at(row.timestamp_secs?)
    }

    /// Saves the map and notes the size of its file.
    pub(crate) fn save_map(&mut self, folder: &RunFolder) -> Result<(), RunError> {
        let path = folder.join(MAP);
        fgs_splat::write_ply(&path, &self.gaussians)?;
        let metadata =
            std::fs::metadata(&path).map_err(|source| RunError::Read { path, source })?;
        self.metrics.map_bytes = metadata.len();
        Ok(())
    }

    /// Saves what became of each frame.
    pub(crate) fn save_rows(&self, folder: &RunFolder) -> Result<(), RunError> {
        folder.write(FRAMES, |file| frame_log::write(&self.rows, file))
    }
}
