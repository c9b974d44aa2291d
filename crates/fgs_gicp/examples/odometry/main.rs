//! Odometry by registration alone: tracks a depth sequence against a sparse map that is extended at
//! keyframes, and reports the absolute trajectory error.
//!
//! `cargo run --release -p fgs_gicp --example odometry -- DIR [key=value ...]`, where DIR is a
//! recording with ground-truth poses. The keys are listed in `recipe.rs`; pass `camera=FILE` if DIR
//! has no `camera.toml`.

#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "an example prints"
)]

mod recipe;
mod tracker;

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result};
use fgs_data::{CameraFile, Dataset, OpenOptions, Trajectory};
use fgs_eval::{ate, rpe};

use recipe::Recipe;
use tracker::Tracker;

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (dir, options) = arguments
        .split_first()
        .context("usage: odometry DIR [key=value ...]")?;
    let recipe = Recipe::parse(options)?;
    let camera = recipe.camera.as_deref().map(CameraFile::read).transpose()?;
    let dataset = Dataset::open(
        Path::new(dir),
        &OpenOptions {
            camera,
            ..OpenOptions::default()
        },
    )?;
    let truth = dataset.ground_truth().context("no known poses")?;
    let mut tracker = Tracker::new(recipe);
    let (mut estimated, mut reference, mut times) = (Vec::new(), Vec::new(), Vec::new());
    let (mut secs, mut iterations) = (0.0, 0);
    let frames = dataset.len().min(tracker.recipe.frames);
    let mut preparation = 0.0;
    for frame in dataset.frames(0..frames) {
        let frame = frame?;
        let start = Instant::now();
        let pose = tracker.track(&frame.depth_m, &frame.camera)?;
        secs += start.elapsed().as_secs_f64();
        preparation += tracker.preparation_secs;
        iterations += tracker.iterations;
        times.push(frame.timestamp_secs);
        estimated.push(pose);
        reference.push(
            truth
                .at(frame.timestamp_secs)
                .context("a frame without pose")?,
        );
    }
    let n = frames as f64;
    let (ate, rpe) = (
        ate(&estimated, &reference)?,
        rpe(&estimated, &reference, 1)?,
    );
    if let Ok(path) = std::env::var("TRAJECTORY") {
        Trajectory::new(times.into_iter().zip(estimated))?.write(Path::new(&path))?;
    }
    println!(
        "ATE {:.4} cm  RPE {:.3} mm  {:.1} ms/frame ({:.1} prep)  {:.1} iterations  {} keyframes  {} points  {} lost",
        100.0 * ate.translation_m.rmse,
        1000.0 * rpe.translation_m.rmse,
        1000.0 * secs / n,
        1000.0 * preparation / n,
        iterations as f64 / n,
        tracker.keyframes,
        tracker.map.len(),
        tracker.lost,
    );
    Ok(())
}
