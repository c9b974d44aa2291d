//! What a run leaves: in memory, and in its folder.

use std::fs;

use anyhow::Context;
use fgs_data::Trajectory;
use fgs_geom::Se3;
use fgs_splat::Gaussians;

use crate::frame_log::{self, FrameRow};
use crate::metrics::Metrics;
use crate::run_folder::{CONFIG, FRAMES, MAP, RunFolder, TRAJECTORY};
use crate::settings::Settings;

/// A run's results.
pub struct RunResult {
    /// One row a frame, of successive frames.
    pub rows: Vec<FrameRow>,
    /// The poses of the tracked frames.
    pub trajectory: Trajectory,
    /// The map.
    pub gaussians: Gaussians,
    /// The numbers.
    pub metrics: Metrics,
}

impl RunResult {
    /// Saves everything, the metrics last.
    ///
    /// # Errors
    /// If writing fails.
    pub fn save(&mut self, folder: &RunFolder, settings: &Settings) -> anyhow::Result<()> {
        let map = folder.join(MAP);
        fgs_splat::write_ply(&map, &self.gaussians)?;
        self.metrics.map_bytes = fs::metadata(&map)
            .with_context(|| format!("cannot read {}", map.display()))?
            .len();
        self.trajectory.write(&folder.join(TRAJECTORY))?;
        let config = settings.to_toml()?;
        folder.write(CONFIG, |file| {
            Ok(std::io::Write::write_all(file, config.as_bytes())?)
        })?;
        self.save_numbers(folder)
    }

    /// Saves rows and metrics.
    ///
    /// # Errors
    /// If writing fails.
    pub fn save_numbers(&self, folder: &RunFolder) -> anyhow::Result<()> {
        folder.write(FRAMES, |file| frame_log::write(&self.rows, file))?;
        self.metrics.write(folder)
    }

    /// Reads what [`RunResult::save`] saved.
    ///
    /// # Errors
    /// If a file is missing or damaged.
    pub fn read(folder: &RunFolder) -> anyhow::Result<Self> {
        Ok(Self {
            metrics: Metrics::read(folder)?,
            rows: frame_log::read(&folder.join(FRAMES))?,
            trajectory: Trajectory::read(&folder.join(TRAJECTORY))?,
            gaussians: fgs_splat::read_ply(&folder.join(MAP))?,
        })
    }

    /// A frame's pose, if it has one.
    pub fn pose(&self, row: &FrameRow) -> Option<Se3> {
        self.trajectory.at(row.timestamp_secs?)
    }
}
