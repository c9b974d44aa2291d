//! Odometry by registration alone: tracks a depth sequence against a sparse map that grows at
//! keyframes, and reports the absolute trajectory error.
//!
//! `cargo run --release -p fgs_gicp --example odometry -- DIR [key=value ...]`, where DIR holds
//! `results/depthNNNNNN.png` and `traj.txt` (Replica layout) or `depth.txt` and `groundtruth.txt`
//! (TUM layout), and `camera.toml`. The keys are in `recipe.rs`.

mod recipe;
mod sequence;
mod tracker;

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result};
use fgs_geom::Se3;
use nalgebra::{Matrix3, Vector3};

use recipe::Recipe;
use sequence::Sequence;
use tracker::Tracker;

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (dir, options) = arguments
        .split_first()
        .context("usage: odometry DIR [key=value ...]")?;
    let sequence = Sequence::open(Path::new(dir))?;
    let recipe = Recipe::parse(options)?;
    let mut tracker = Tracker::new(recipe);
    let mut estimated = Vec::new();
    let (mut secs, mut iterations) = (0.0, 0);
    let frames = sequence.depth_files.len().min(tracker.recipe.frames);
    let mut preparation = 0.0;
    for file in &sequence.depth_files[..frames] {
        let depth_m = sequence.read_depth(file)?;
        let start = Instant::now();
        let pose = tracker.track(&depth_m, &sequence.camera)?;
        secs += start.elapsed().as_secs_f64();
        preparation += tracker.preparation_secs;
        iterations += tracker.iterations;
        estimated.push(pose);
    }
    if let Ok(path) = std::env::var("TRAJECTORY") {
        let lines: Vec<String> = estimated
            .iter()
            .enumerate()
            .map(|(i, pose)| {
                let (t, q) = (pose.translation, pose.rotation.coords);
                format!(
                    "{i} {} {} {} {} {} {} {}\n",
                    t.x, t.y, t.z, q.x, q.y, q.z, q.w
                )
            })
            .collect();
        std::fs::write(path, lines.concat())?;
    }
    let reference = &sequence.world_from_camera[..frames];
    let n = frames as f64;
    println!(
        "ATE {:.4} cm  RPE {:.3} mm  {:.1} ms/frame ({:.1} prep)  {:.1} iterations  {} keyframes  {} points  {} lost",
        100.0 * absolute_error(&estimated, reference),
        1000.0 * relative_error(&estimated, reference),
        1000.0 * secs / n,
        1000.0 * preparation / n,
        iterations as f64 / n,
        tracker.keyframes,
        tracker.map.len(),
        tracker.lost,
    );
    Ok(())
}

/// Root mean square position error after the best rigid alignment, metres.
fn absolute_error(estimated: &[Se3], reference: &[Se3]) -> f64 {
    let n = estimated.len() as f64;
    let mean = |poses: &[Se3]| poses.iter().map(|p| p.translation).sum::<Vector3<f64>>() / n;
    let (from, to) = (mean(estimated), mean(reference));
    let pairs = || {
        let relative = |(e, r): (&Se3, &Se3)| (e.translation - from, r.translation - to);
        estimated.iter().zip(reference).map(relative)
    };
    let covariance: Matrix3<f64> = pairs().map(|(e, r)| r * e.transpose()).sum();
    let svd = covariance.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return f64::NAN;
    };
    let mirror = (u * v_t).determinant().signum();
    let rotation = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, mirror)) * v_t;
    (pairs()
        .map(|(e, r)| (rotation * e - r).norm_squared())
        .sum::<f64>()
        / n)
        .sqrt()
}

/// Root mean square error of the motion from frame to frame, metres.
fn relative_error(estimated: &[Se3], reference: &[Se3]) -> f64 {
    let motion = |poses: &[Se3]| -> Vec<Se3> {
        poses
            .windows(2)
            .map(|pair| pair[0].inverse() * pair[1])
            .collect()
    };
    let (e, r) = (motion(estimated), motion(reference));
    let errors = e
        .iter()
        .zip(&r)
        .map(|(e, r)| (r.inverse() * *e).translation.norm_squared());
    (errors.sum::<f64>() / e.len() as f64).sqrt()
}
