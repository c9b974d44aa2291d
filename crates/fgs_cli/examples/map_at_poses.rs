//! How good a map gets at given poses: `map_at_poses DATASET TRAJECTORY...` maps the recording
//! once for each trajectory (TUM format), without tracking, from the same keyframes with the same
//! number of steps, and prints PSNR and depth L1 over all frames.

use std::path::Path;
use std::sync::Arc;

use fgs_data::{Dataset, OpenOptions, Trajectory};
use fgs_eval::{depth_error, image_quality};
use fgs_geom::{Image, View};
use fgs_slam::{Keyframe, KeyframeKind, Mapper, SlamConfig, model_settings};
use fgs_splat::{CpuModel, Rasterizer};

/// Poses further from a frame's time are not interpolated.
const MAX_GAP_SECS: f64 = 0.1;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments
        .next()
        .ok_or("usage: map_at_poses DATASET TRAJECTORY...")?;
    let dataset = Dataset::open(Path::new(&path), &OpenOptions::default())?;
    for path in arguments {
        let trajectory = Trajectory::read(Path::new(&path))?;
        let (psnr_db, depth_l1_m) = map_quality(&dataset, &trajectory)?;
        println!(
            "{path}: PSNR {psnr_db:.2} dB over valid depth, depth L1 {:.2} cm",
            100.0 * depth_l1_m
        );
    }
    Ok(())
}

/// Mean PSNR over pixels with depth (dB) and mean depth L1 (m) of the finished map.
fn map_quality(
    dataset: &Dataset,
    trajectory: &Trajectory,
) -> Result<(f64, f64), Box<dyn std::error::Error>> {
    let config = SlamConfig::default();
    let model = CpuModel::new(model_settings(&config.mapping));
    let mut mapper = Mapper::new(model, dataset.camera(), &config);
    let every = config.keyframes.mapping_every;
    let steps = (every as f64 * config.mapping.iterations_per_frame).round() as usize;
    for index in (0..dataset.len()).step_by(every) {
        let frame = dataset.frame(index)?;
        let Some(world_from_camera) = trajectory.interpolate(frame.timestamp_secs, MAX_GAP_SECS)
        else {
            continue;
        };
        mapper.insert(&Keyframe {
            kind: KeyframeKind::Mapping,
            frame: Arc::new(frame),
            world_from_camera,
            new_points: Vec::new(),
        })?;
        for _ in 0..steps {
            mapper.step()?;
        }
    }
    let gaussians = mapper.into_gaussians();
    let mut rasterizer = Rasterizer::default();
    let (mut psnr_db, mut depth_l1_m) = (Vec::new(), Vec::new());
    for frame in dataset.frames(0..dataset.len()) {
        let frame = frame?;
        let Some(world_from_camera) = trajectory.interpolate(frame.timestamp_secs, MAX_GAP_SECS)
        else {
            continue;
        };
        let view = View {
            camera: frame.camera,
            world_from_camera,
        };
        let pass = rasterizer.render(&gaussians, &view);
        let rendered = pass.rendered();
        let surface_m = Image::from_fn(view.camera.width, view.camera.height, |u, v| {
            rendered.surface_depth_m(u, v)
        });
        psnr_db.extend(
            image_quality(
                &rendered.color,
                &frame.color,
                &frame.depth_m,
                frame.color_valid.as_deref(),
            )?
            .psnr_valid_depth_db,
        );
        depth_l1_m.extend(
            depth_error(&surface_m, &rendered.alpha, &frame.depth_m)?.map(|error| error.l1_m),
        );
    }
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    Ok((mean(&psnr_db), mean(&depth_l1_m)))
}
