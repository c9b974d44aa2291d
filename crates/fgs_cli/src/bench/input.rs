//! What the stages are timed on: consecutive frames with known poses.

use std::path::Path;

use anyhow::{Context, bail};
use fgs_data::Dataset;
use fgs_geom::{RgbdFrame, Se3};
use fgs_run::{Settings, open_recording, recording_name};
use fgs_synth::{SensorModel, Sequence, kinect_camera};

use crate::failure::UsageError;

/// Frames of a recording: 50 pairs of neighbours.
const RECORDED_FRAMES: usize = 51;
/// Frames of a synthetic room, which take longer to make than to work on.
const SYNTHETIC_FRAMES: usize = 11;
const SEED: u64 = 5;

/// Frames and where they were taken.
pub struct Input {
    pub name: String,
    /// Where the frames came from, if not made up.
    pub dataset: Option<Dataset>,
    pub frames: Vec<RgbdFrame>,
    pub world_from_camera: Vec<Se3>,
}

impl Input {
    /// Of a synthetic room seen with exact depth.
    pub fn synthetic(width: usize, height: usize) -> anyhow::Result<Self> {
        let camera =
            kinect_camera(width, height).map_err(|error| UsageError(format!("--size: {error}")))?;
        let sequence = Sequence::new(SEED, SYNTHETIC_FRAMES, camera, SensorModel::exact());
        Ok(Self {
            name: format!("{width}x{height}"),
            dataset: None,
            frames: sequence.frames().collect(),
            world_from_camera: (0..sequence.len())
                .map(|i| sequence.world_from_camera(i))
                .collect(),
        })
    }

    /// Of a recording, from its frame `first`.
    pub fn recorded(path: &Path, first: usize, camera: Option<&Path>) -> anyhow::Result<Self> {
        let dataset = open_recording(path, camera, &mut Settings::default())?;
        let truth = dataset
            .ground_truth()
            .context("the recording has no known poses")?;
        let end = dataset.len().min(first.saturating_add(RECORDED_FRAMES));
        let (mut frames, mut world_from_camera) = (Vec::new(), Vec::new());
        for frame in dataset.frames(first.min(end)..end) {
            let frame = frame?;
            if let Some(pose) = truth.at(frame.timestamp_secs) {
                world_from_camera.push(pose);
                frames.push(frame);
            }
        }
        if frames.len() < 2 {
            bail!(
                "{} has no two frames with known poses from frame {first} on",
                path.display()
            );
        }
        Ok(Self {
            name: recording_name(path).to_string_lossy().into_owned(),
            dataset: Some(dataset),
            frames,
            world_from_camera,
        })
    }
}
