//! `metrics.json`: a run in numbers.

use std::io::{self, Write};
use std::path::PathBuf;

use fgs_data::plain_words;
use fgs_files::{StagedFolder, read_text};
use fgs_slam::{Execution, Holdout};
use serde::{Deserialize, Serialize};

use crate::error::RunError;
use crate::run_folder::{METRICS, RunFolder, write};
use crate::score_values::Scores;

/// Some sixty numbers take 2 kB.
const MAX_BYTES: u64 = 1 << 20;

/// A run in numbers. What was not computed is `null`, as is an infinite signal-to-noise ratio.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// Frames that arrived, whatever became of them.
    pub frames: usize,
    /// Of those: arrived too late in real time.
    pub frames_dropped: usize,
    /// Of those: have no pose that can be trusted.
    pub frames_lost: usize,
    /// Of those: have a pose that is probably right, on which nothing was built.
    #[serde(default)]
    pub frames_weak: usize,
    /// Of those: could not be read.
    pub frames_damaged: usize,
    /// Of those: have a pose in another sub-map than the largest. No score covers them. Left out if there are
    /// none.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub frames_elsewhere: usize,
    /// Sub-maps beside the largest; left out if there are none.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub further_submaps: usize,
    /// Whether the run was stopped early.
    pub interrupted: bool,
    /// Why mapping failed, which ended the run early.
    pub failure: Option<String>,
    /// Whether the trajectory's errors are differences from the device's own poses, which are estimates too.
    /// Left out if they are from the truth.
    #[serde(default, skip_serializing_if = "is_false")]
    pub reference_is_device: bool,
    /// How good trajectory and map are; the keys are the names in [`SCORES`](crate::SCORES).
    #[serde(flatten)]
    pub scores: Scores,
    /// Reserved; always `null`.
    pub lpips: Option<f64>,
    /// Frames per second of wall-clock time, decoding included.
    pub fps: Option<f64>,
    /// Mean wall-clock time of tracking a frame.
    pub tracking_ms: Option<f64>,
    /// Wall-clock time of mapping per frame tracked or lost.
    pub mapping_ms: Option<f64>,
    /// Optimisation steps.
    pub iterations: usize,
    /// Optimisation steps per frame tracked or lost.
    pub iterations_per_frame: Option<f64>,
    /// Keyframes of both kinds.
    pub keyframes: usize,
    /// How often the camera was found to be back at a place and drift was taken out.
    pub loops: usize,
    /// Gaussians in the map.
    pub num_gaussians: usize,
    /// Size of the map's file; 0 if it could not be written.
    pub map_bytes: u64,
    /// Peak resident memory of the process when tracking, mapping and refinement ended.
    pub peak_rss_bytes: Option<u64>,
    /// Memory that the map takes on the graphics device at the end.
    pub device_bytes: u64,
    /// The seed.
    pub seed: u64,
    /// The commit that this library was built from.
    pub commit: String,
    /// How tracker and mapper took turns.
    pub mode: Execution,
    /// Where the map was optimised: "CPU" or the graphics device's name.
    pub backend: String,
    /// Threads of the pool that computes.
    pub threads: usize,
    /// The recording, as seen from the run's folder where it can be.
    pub dataset: PathBuf,
    /// Of every so many frames, the last was kept out of the map; left out if none was.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub eval_holdout: Option<Holdout>,
    /// The map after refinement; left out if there was none. All else but the peak of memory is about
    /// the run up to the end of the recording.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refined: Option<RefinedMetrics>,
}

/// What became of the map by optimisation after the end of the recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RefinedMetrics {
    /// Optimisation steps after the end of the recording.
    pub steps: usize,
    /// Wall-clock time that they took.
    pub seconds: f64,
    /// How good the refined map is: those of [`SCORES`](crate::SCORES) that are about the map, by the
    /// same names; left out where they are not known.
    #[serde(flatten, serialize_with = "Scores::serialize_known")]
    pub scores: Scores,
    /// Gaussians in the refined map.
    pub num_gaussians: usize,
    /// Size of its file; 0 if it could not be written.
    pub map_bytes: u64,
}

/// Whether there is nothing to tell.
#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_zero(count: &usize) -> bool {
    *count == 0
}

#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_false(value: &bool) -> bool {
    !value
}

impl Metrics {
    /// Reads a run's metrics.
    ///
    /// # Errors
    /// If there are none or they are damaged.
    pub fn read(folder: &RunFolder) -> Result<Self, RunError> {
        let path = folder.join(METRICS);
        read_text(&path, MAX_BYTES)
            .and_then(|text| {
                serde_json::from_str(&text).map_err(|error| {
                    io::Error::new(io::ErrorKind::InvalidData, plain_words(&error.to_string()))
                })
            })
            .map_err(|source| RunError::Read { path, source })
    }

    /// Writes them among a run's results.
    pub(crate) fn write(&self, results: &StagedFolder<'_>) -> Result<(), RunError> {
        write(results, METRICS, |file| {
            serde_json::to_writer_pretty(&mut *file, self)?;
            writeln!(file)
        })
        .map(drop)
    }

    /// A small table for people.
    pub fn table(&self) -> String {
        let mut lines = Vec::new();
        let mut line = |name: &str, text: String| lines.push(table_line(2, name, &text));
        let map = |gaussians: usize, bytes: u64| {
            let megabytes = bytes as f64 / 1e6;
            format!("{gaussians} gaussians, {megabytes:.1} MB")
        };
        line(
            "frames",
            format!(
                "{} ({} lost, {} weak, {} damaged, {} dropped), {} keyframes, {} loops",
                self.frames,
                self.frames_lost,
                self.frames_weak,
                self.frames_damaged,
                self.frames_dropped,
                self.keyframes,
                self.loops
            ),
        );
        if self.further_submaps > 0 {
            let text = format!(
                "{} more, with {} frames, which no score covers",
                self.further_submaps, self.frames_elsewhere
            );
            line("sub-maps", text);
        }
        for (name, text) in self.scores.shown() {
            line(name, text);
        }
        if self.reference_is_device {
            let text = "of ATE: the device's own poses, which are estimates too";
            line("reference", text.into());
        }
        if let (Some(fps), Some(tracking)) = (self.fps, self.tracking_ms) {
            let iterations = self.iterations_per_frame.unwrap_or_default();
            line(
                "speed",
                format!(
                    "{fps:.2} frames/s at {iterations:.1} iterations a frame, tracking {tracking:.1} ms"
                ),
            );
        }
        line("map", map(self.num_gaussians, self.map_bytes));
        if let Some(refined) = &self.refined {
            let RefinedMetrics { steps, seconds, .. } = refined;
            line("refined", format!("{steps} more steps in {seconds:.1} s"));
            let mut line = |name: &str, text: String| lines.push(table_line(4, name, &text));
            for (name, text) in refined.scores.shown() {
                line(name, text);
            }
            line("map", map(refined.num_gaussians, refined.map_bytes));
        }
        lines.join("\n")
    }
}

fn table_line(indent: usize, name: &str, text: &str) -> String {
    format!("{:indent$}{name:<11}{text}", "")
}

#[cfg(test)]
mod tests {
    use fgs_files::OutputFolder;

    use super::*;
    use crate::run_folder::CONFIG;

    const SAVED: &str = r#"{
  "frames": 6,
  "frames_dropped": 1,
  "frames_lost": 2,
  "frames_weak": 1,
  "frames_damaged": 3,
  "interrupted": false,
  "failure": null,
  "ate_rmse_m": 0.0125,
  "ate_mean_m": 0.01,
  "rpe_mean_m": 0.001,
  "psnr_valid_depth_db": 25.5,
  "psnr_db": 24.0,
  "psnr_paper_db": 26.0,
  "psnr_exposure_valid_depth_db": 26.5,
  "psnr_exposure_db": 25.0,
  "psnr_heldout_db": null,
  "ssim": 0.875,
  "depth_l1_m": 0.015,
  "lpips": null,
  "fps": 10.0,
  "tracking_ms": 20.0,
  "mapping_ms": 80.0,
  "iterations": 60,
  "iterations_per_frame": 10.0,
  "keyframes": 4,
  "loops": 0,
  "num_gaussians": 1000,
  "map_bytes": 68000,
  "peak_rss_bytes": null,
  "device_bytes": 0,
  "seed": 1,
  "commit": "unknown",
  "mode": "lockstep",
  "backend": "CPU",
  "threads": 2,
  "dataset": "room"
}
"#;

    /// Users' scripts read these names, and people the table.
    #[test]
    fn names_order_and_table_stay_as_they_are() {
        let parent = tempfile::tempdir().unwrap();
        let output = OutputFolder::claim(&parent.path().join("run")).unwrap();
        let results = output.begin().unwrap();
        for (name, text) in [(METRICS, SAVED), (CONFIG, "")] {
            write(&results, name, |file| file.write_all(text.as_bytes())).unwrap();
        }
        results.finish().unwrap();
        let folder = RunFolder::open(output.path()).unwrap();
        let metrics = Metrics::read(&folder).unwrap();
        assert_eq!(metrics.scores.get("ssim"), Some(0.875));
        let results = output.begin().unwrap();
        metrics.write(&results).unwrap();
        results.finish().unwrap();
        let again = std::fs::read_to_string(folder.join(METRICS)).unwrap();
        assert_eq!(again, SAVED);
        assert_eq!(
            metrics.table(),
            "  frames     6 (2 lost, 1 weak, 3 damaged, 1 dropped), 4 keyframes, 0 loops\n\
             \x20 ATE        1.250 cm rmse, 1.000 cm mean\n\
             \x20 PSNR       25.50 dB where depth is measured, 24.00 dB everywhere, 26.50 dB with exposure\n\
             \x20 SSIM       0.8750\n\
             \x20 depth L1   1.50 cm\n\
             \x20 speed      10.00 frames/s at 10.0 iterations a frame, tracking 20.0 ms\n\
             \x20 map        1000 gaussians, 0.1 MB"
        );
    }

    /// Both go beside what is there without them.
    #[test]
    fn refinement_and_test_views_have_keys_and_lines_of_their_own() {
        let test_views = r#"
  "test_psnr_db": 22.0,
  "test_ssim": 0.75,"#;
        let added = r#""dataset": "room",
  "eval_holdout": 8,
  "refined": {
    "steps": 2000,
    "seconds": 31.25,
    "psnr_db": 27.0,
    "ssim": 0.9375,
    "test_psnr_db": 23.0,
    "num_gaussians": 900,
    "map_bytes": 51000
  }"#;
        let text = SAVED
            .replace("0.015,", &format!("0.015,{test_views}"))
            .replace(r#""dataset": "room""#, added);
        let metrics: Metrics = serde_json::from_str(&text).unwrap();
        let again = serde_json::to_string_pretty(&metrics).unwrap();
        assert_eq!(again, text.trim_end());
        let plain: Metrics = serde_json::from_str(SAVED).unwrap();
        assert_eq!(
            metrics.table(),
            plain.table().replace(
                "1.50 cm",
                "1.50 cm\n  test views 22.00 dB everywhere, 0.7500 SSIM"
            ) + "\n  refined    2000 more steps in 31.2 s\n\
                   \x20   PSNR       27.00 dB everywhere\n\
                   \x20   SSIM       0.9375\n\
                   \x20   test views 23.00 dB everywhere\n\
                   \x20   map        900 gaussians, 0.1 MB"
        );
    }
}
