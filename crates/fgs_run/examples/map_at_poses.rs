//! How good a map gets at given poses: `map_at_poses DATASET TRAJECTORY...` maps the recording
//! once for each trajectory (TUM format), without tracking, from the same keyframes with the same
//! number of steps, and prints PSNR and depth L1 over all frames.

#![allow(clippy::print_stdout, reason = "an example prints")]

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use fgs_data::{Dataset, OpenOptions, Trajectory};
use fgs_geom::KeyframeId;
use fgs_run::{FrameRow, Scores, score_images};
use fgs_slam::{
    FrameStatus, Keyframe, KeyframeKind, KeyframePreparer, Mapper, SlamConfig, model_settings,
};
use fgs_splat::{CpuModel, Gaussians};

/// Poses further from a frame's time are not interpolated.
const MAX_GAP_SECS: f64 = 0.1;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments
        .next()
        .ok_or("usage: map_at_poses DATASET TRAJECTORY...")?;
    let dataset = Dataset::open(Path::new(&path), &OpenOptions::default())?;
    for path in arguments {
        let poses = at_frames(&dataset, &Trajectory::read(Path::new(&path))?)?;
        let scores = score(&dataset, &poses, &map(&dataset, &poses)?)?;
        let of = |name| scores.get(name).unwrap_or(f64::NAN);
        println!(
            "{path}: PSNR {:.2} dB over valid depth, depth L1 {:.2} cm",
            of("psnr_valid_depth_db"),
            100.0 * of("depth_l1_m")
        );
    }
    Ok(())
}

/// The poses at the times of the frames.
fn at_frames(dataset: &Dataset, trajectory: &Trajectory) -> Result<Trajectory> {
    let poses = dataset
        .timestamps()
        .filter_map(|secs| Some((secs, trajectory.interpolate(secs, MAX_GAP_SECS)?)));
    Ok(Trajectory::new(poses)?)
}

/// The map that keyframes at even distances give.
fn map(dataset: &Dataset, poses: &Trajectory) -> Result<Gaussians> {
    let config = SlamConfig::default();
    let model = CpuModel::new(model_settings(&config.mapping));
    let mut mapper = Mapper::new(Box::new(model), &config);
    let mut preparer = KeyframePreparer::new(dataset.camera(), &config);
    let every = config.keyframes.mapping_every;
    let steps = (every as f64 * config.mapping.iterations_per_frame).round() as usize;
    for index in (0..dataset.len()).step_by(every) {
        let frame = dataset.frame(index)?;
        let Some(world_from_camera) = poses.at(frame.timestamp_secs) else {
            continue;
        };
        let keyframe = Keyframe {
            id: KeyframeId(index.try_into()?),
            kind: KeyframeKind::Mapping,
            frame: Arc::new(frame),
            world_from_camera,
            previous: None,
            information: None,
            new_points: Vec::new(),
        };
        let missing = mapper.missing_region(&keyframe)?;
        mapper.insert(preparer.prepare(keyframe, missing)?)?;
        for _ in 0..steps {
            mapper.step()?;
        }
    }
    Ok(mapper.into_gaussians())
}

/// The mean scores over all frames that have a pose.
fn score(dataset: &Dataset, poses: &Trajectory, gaussians: &Gaussians) -> Result<Scores> {
    let mut rows: Vec<FrameRow> = dataset
        .timestamps()
        .enumerate()
        .map(|(index, secs)| FrameRow {
            timestamp_secs: Some(secs),
            ..FrameRow::new(index, FrameStatus::Tracked)
        })
        .collect();
    let never = AtomicBool::new(false);
    score_images(&mut rows, poses, gaussians, dataset, &mut (), &never)?;
    let mut scores = Scores::default();
    scores.set_means(&rows, None);
    Ok(scores)
}
