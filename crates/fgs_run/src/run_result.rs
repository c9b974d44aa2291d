//! What a run leaves: in memory, and in its folder.

use fgs_data::Trajectory;
use fgs_files::StagedFolder;
use fgs_geom::Se3;
use fgs_splat::Gaussians;

use crate::error::RunError;
use crate::frame_log::{self, FrameRow};
use crate::metrics::Metrics;
use crate::run_folder::{FRAMES, MAP, REFINED_MAP, RunFolder, TRAJECTORY, of_submap, write};
use crate::up;

/// A part of a recording that nothing connects to the largest, in axes of its own.
#[derive(Debug)]
pub struct FurtherSubmap {
    /// The poses of its tracked frames, `submap_from_camera`.
    pub trajectory: Trajectory,
    /// Its map when the recording had ended.
    pub gaussians: Gaussians,
    /// Its map after refinement, if there was any.
    pub refined: Option<Gaussians>,
}

/// A run's results. What is not said to be of all sub-maps is of the largest.
#[derive(Debug)]
pub struct RunResult {
    /// One row for each frame, of successive frames.
    pub rows: Vec<FrameRow>,
    /// The poses of the tracked frames in the largest sub-map, `world_from_camera`.
    pub trajectory: Trajectory,
    /// The other sub-maps, from number 1 on; none if the run was read from its folder.
    pub further: Vec<FurtherSubmap>,
    /// The map when the recording had ended.
    pub gaussians: Gaussians,
    /// The map after refinement, if there was any.
    pub refined: Option<Gaussians>,
    /// The numbers.
    pub metrics: Metrics,
    /// Why the map's checkpoints ended early.
    pub checkpoint_failure: Option<RunError>,
}

impl RunResult {
    /// Reads what a run has saved.
    ///
    /// # Errors
    /// If a file is missing or damaged.
    pub fn read(folder: &RunFolder) -> Result<Self, RunError> {
        let metrics = Metrics::read(folder)?;
        let read_map = |name: &str| fgs_splat::read_ply(&folder.join(name));
        Ok(Self {
            rows: Self::read_rows(folder)?,
            trajectory: Trajectory::read(&folder.join(TRAJECTORY))?,
            further: Vec::new(),
            gaussians: read_map(MAP)?,
            refined: match metrics.refined {
                Some(_) => Some(read_map(REFINED_MAP)?),
                None => None,
            },
            metrics,
            checkpoint_failure: None,
        })
    }

    /// Reads what became of each frame, alone.
    ///
    /// # Errors
    /// If the file is missing or damaged.
    pub fn read_rows(folder: &RunFolder) -> Result<Vec<FrameRow>, RunError> {
        frame_log::read(&folder.join(FRAMES))
    }

    /// A frame's pose `world_from_camera`, if it has one in the largest sub-map.
    pub fn pose(&self, row: &FrameRow) -> Option<Se3> {
        self.trajectory.at(row.timestamp_secs?)
    }

    /// The refined map if there is one, else the map.
    pub fn finest_map(&self) -> &Gaussians {
        self.refined.as_ref().unwrap_or(&self.gaussians)
    }

    /// The poses `world_from_camera` of the tracked frames in the largest sub-map, in their order.
    pub fn poses(&self) -> Vec<Se3> {
        let poses = self.trajectory.poses().iter();
        poses.map(|pose| pose.world_from_camera).collect()
    }

    /// Saves the poses.
    pub(crate) fn save_trajectory(&self, results: &StagedFolder<'_>) -> Result<(), RunError> {
        write(results, TRAJECTORY, |file| self.trajectory.encode(file)).map(drop)
    }

    /// Saves the sub-maps beside the largest.
    pub(crate) fn save_further(&self, results: &StagedFolder<'_>) -> Result<(), RunError> {
        for (submap, number) in self.further.iter().zip(1..) {
            let name = |name: &str| of_submap(name, number);
            write(results, &name(TRAJECTORY), |file| {
                submap.trajectory.encode(file)
            })?;
            write_map(&submap.gaussians, results, &name(MAP))?;
            if let Some(refined) = &submap.refined {
                write_map(refined, results, &name(REFINED_MAP))?;
            }
        }
        Ok(())
    }

    /// Saves the map and notes the size of its file.
    pub(crate) fn save_map(&mut self, results: &StagedFolder<'_>) -> Result<(), RunError> {
        self.metrics.map_bytes = write_map(&self.gaussians, results, MAP)?;
        Ok(())
    }

    /// Saves the refined map, if there is one, and notes the size of its file.
    pub(crate) fn save_refined_map(&mut self, results: &StagedFolder<'_>) -> Result<(), RunError> {
        if let (Some(gaussians), Some(metrics)) = (&self.refined, &mut self.metrics.refined) {
            metrics.map_bytes = write_map(gaussians, results, REFINED_MAP)?;
        }
        Ok(())
    }

    /// Saves which way is up.
    pub(crate) fn save_up(&self, results: &StagedFolder<'_>) -> Result<(), RunError> {
        up::save(&up::find(self.finest_map(), &self.poses()), results)
    }

    /// Saves what became of each frame.
    pub(crate) fn save_rows(&self, results: &StagedFolder<'_>) -> Result<(), RunError> {
        write(results, FRAMES, |file| frame_log::write(&self.rows, file)).map(drop)
    }
}

/// Writes a map; returns the size of its file.
pub(crate) fn write_map(
    gaussians: &Gaussians,
    results: &StagedFolder<'_>,
    name: &str,
) -> Result<u64, RunError> {
    write(results, name, |file| fgs_splat::encode_ply(file, gaussians))
}
