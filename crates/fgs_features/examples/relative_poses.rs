//! Relative poses of pairs of frames of recordings against their reference poses.
//!
//! `cargo run --release -p fgs_features --example relative_poses -- FOLDER` reads the recordings
//! hololens, tum_fr1_rpy and redkitchen in a folder and prints a table: how many pairs are answered
//! and how well, and how many pairs of frames that show different places are answered.

#![allow(clippy::print_stdout, reason = "an example prints")]

use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use fgs_data::{Dataset, OpenOptions};
use fgs_features::{Features, RelativePose, match_features, relative_pose};
use fgs_geom::Se3;
use nalgebra::Vector3;

const SEED: u64 = 1;

struct Recording {
    frames: Vec<(Features, Option<Se3>)>,
    detection: Duration,
}

impl Recording {
    fn read(path: &Path, limit: usize) -> Result<Self> {
        let dataset = Dataset::open(path, &OpenOptions::default())?;
        let poses = dataset.ground_truth().context("no reference poses")?;
        let mut detection = Duration::ZERO;
        let mut frames = Vec::new();
        for frame in dataset.frames(0..dataset.len().min(limit)) {
            let frame = frame?;
            let start = Instant::now();
            let features = Features::detect(&frame);
            detection += start.elapsed();
            frames.push((features, poses.at(frame.timestamp_secs)));
        }
        let detection = detection / frames.len() as u32;
        Ok(Self { frames, detection })
    }
}

/// Counts over pairs of frames.
#[derive(Default)]
struct Tally {
    pairs: usize,
    /// Within 2 cm and 1 degree.
    close: usize,
    /// Within 5 cm and 3 degrees.
    near: usize,
    /// Off by more than 10 cm or 5 degrees.
    wrong: usize,
    matches: usize,
    /// Of each answer.
    inliers: Vec<usize>,
    matching: Duration,
    estimation: Duration,
}

impl Tally {
    fn add(&mut self, a: &Features, b: &Features, truth: Option<Se3>) {
        let start = Instant::now();
        let matches = match_features(a, b);
        let matched = Instant::now();
        let found = relative_pose(a, b, &matches, SEED);
        self.matching += matched - start;
        self.estimation += matched.elapsed();
        self.pairs += 1;
        self.matches += matches.len();
        let Some(RelativePose {
            a_from_b, inliers, ..
        }) = found
        else {
            return;
        };
        self.inliers.push(inliers);
        let (distance, angle) = truth.map_or((f64::INFINITY, f64::INFINITY), |truth| {
            let error = truth.inverse() * a_from_b;
            (
                error.translation.norm(),
                error.rotation.angle().to_degrees(),
            )
        });
        self.close += usize::from(distance <= 0.02 && angle <= 1.0);
        self.near += usize::from(distance <= 0.05 && angle <= 3.0);
        self.wrong += usize::from(distance > 0.1 || angle > 5.0);
    }

    fn print(&mut self, name: &str) {
        let pairs = self.pairs.max(1);
        let percent = |count: usize| 100.0 * count as f64 / pairs as f64;
        let milliseconds = |time: Duration| 1e3 * time.as_secs_f64() / pairs as f64;
        self.inliers.sort_unstable();
        println!(
            "{name:27} {:5} {:8.1} {:7.1} {:7.1} {:6.1} {:7} {:7} {:8.2} {:7.2}",
            self.pairs,
            percent(self.inliers.len()),
            percent(self.close),
            percent(self.near),
            percent(self.wrong),
            self.matches / pairs,
            self.inliers.get(self.inliers.len() / 2).unwrap_or(&0),
            milliseconds(self.matching),
            milliseconds(self.estimation),
        );
    }
}

fn main() -> Result<()> {
    let folder = std::env::args()
        .nth(1)
        .context("give the folder of the recordings")?;
    let read = |name: &str, limit: usize| {
        Recording::read(&Path::new(&folder).join(name), limit).with_context(|| name.to_string())
    };
    let hololens = read("hololens", 190)?;
    let rpy = read("tum_fr1_rpy", 262)?;
    let kitchen = read("redkitchen", 500)?;
    for (name, recording) in [
        ("hololens", &hololens),
        ("rpy", &rpy),
        ("redkitchen", &kitchen),
    ] {
        println!(
            "{name}: detection {:.2} ms",
            1e3 * recording.detection.as_secs_f64()
        );
    }
    println!(
        "{:27} pairs answered 2cm/1dg 5cm/3dg  wrong matches inliers match_ms pose_ms",
        ""
    );
    for (name, recording, gaps, step) in [
        ("hololens", &hololens, [1, 3, 6], 1),
        ("rpy", &rpy, [5, 10, 20], 2),
        ("redkitchen", &kitchen, [10, 30, 60], 5),
    ] {
        for gap in gaps {
            let mut tally = Tally::default();
            for i in (0..recording.frames.len().saturating_sub(gap)).step_by(step) {
                let [(a, pose_a), (b, pose_b)] = [&recording.frames[i], &recording.frames[i + gap]];
                if let (Some(pose_a), Some(pose_b)) = (pose_a, pose_b) {
                    tally.add(a, b, Some(pose_a.inverse() * *pose_b));
                }
            }
            tally.print(&format!("{name} k -> k+{gap}"));
        }
    }
    for (name, first, second) in [
        ("hololens - rpy", &hololens, &rpy),
        ("hololens - redkitchen", &hololens, &kitchen),
        ("rpy - redkitchen", &rpy, &kitchen),
    ] {
        let mut tally = Tally::default();
        for (i, (a, _)) in first.frames.iter().enumerate().step_by(6) {
            for (b, _) in second.frames.iter().skip(i % 20).step_by(20) {
                tally.add(a, b, None);
            }
        }
        tally.print(name);
    }
    // The axes of redkitchen's frames are never that far apart.
    for (name, recording) in [("hololens", &hololens), ("rpy", &rpy)] {
        let mut tally = Tally::default();
        for (i, (a, pose_a)) in recording.frames.iter().enumerate().step_by(5) {
            for (b, pose_b) in recording.frames.iter().skip(i + 1).step_by(7) {
                let (Some(pose_a), Some(pose_b)) = (pose_a, pose_b) else {
                    continue;
                };
                let forward = |pose: &Se3| pose.rotation * Vector3::z();
                if forward(pose_a).angle(&forward(pose_b)) > 1.3 {
                    tally.add(a, b, Some(pose_a.inverse() * *pose_b));
                }
            }
        }
        tally.print(&format!("{name}, axes 75 deg apart"));
    }
    Ok(())
}
