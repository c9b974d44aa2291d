//! `metrics.json`: a run in numbers.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use serde::{Deserialize, Serialize};

use crate::mode::Mode;
use crate::run_folder::{METRICS, RunFolder};

/// Numbers of a run. What was not computed is `null`, as is an infinite signal-to-noise ratio.
/// Image metrics are means over the frames that have a pose, rendered from the final map at their
/// estimated poses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Metrics {
    /// Frames that came, whatever became of them.
    pub frames: usize,
    /// Of those, came too late in real time.
    pub frames_dropped: usize,
    /// Of those, have no pose that can be trusted.
    pub frames_lost: usize,
    /// Of those, could not be read.
    pub frames_damaged: usize,
    /// Whether Ctrl-C ended the run.
    pub interrupted: bool,
    /// Why the map could not be continued, if that ended the run.
    pub failure: Option<String>,
    /// Absolute trajectory error after rigid alignment, root mean square.
    pub ate_rmse_m: Option<f64>,
    /// The same, mean (what the paper calls RMSE).
    pub ate_mean_m: Option<f64>,
    /// Relative pose error from frame to frame, mean translation.
    pub rpe_mean_m: Option<f64>,
    /// Over pixels with measured depth.
    pub psnr_valid_depth_db: Option<f64>,
    /// Over all pixels that the camera saw.
    pub psnr_db: Option<f64>,
    /// As the paper's code computes it.
    pub psnr_paper_db: Option<f64>,
    /// Over pixels with measured depth, of frames that were never keyframes.
    pub psnr_heldout_db: Option<f64>,
    /// Structural similarity.
    pub ssim: Option<f64>,
    /// Mean absolute depth error.
    pub depth_l1_m: Option<f64>,
    /// Not computed yet.
    pub lpips: Option<f64>,
    /// Frames by wall time from first to last, decoding included.
    pub fps: Option<f64>,
    /// Mean wall time of tracking a frame.
    pub tracking_ms: Option<f64>,
    /// Mean wall time of mapping by frame.
    pub mapping_ms: Option<f64>,
    /// Optimisation steps.
    pub iterations: usize,
    /// Optimisation steps by frame tracked or lost.
    pub iterations_per_frame: Option<f64>,
    /// Keyframes of both kinds.
    pub keyframes: usize,
    /// Gaussians in the map.
    pub num_gaussians: usize,
    /// Size of the map's file.
    pub map_bytes: u64,
    /// Most physical memory used until the map was saved.
    pub peak_rss_bytes: Option<u64>,
    /// Memory of the graphics device that the map takes at the end.
    pub device_bytes: u64,
    /// The seed.
    pub seed: u64,
    /// The program's commit.
    pub commit: String,
    /// How tracker and mapper took turns.
    pub mode: Mode,
    /// Where the map was optimised: "CPU" or the graphics device's name.
    pub backend: String,
    /// Threads that computed.
    pub threads: usize,
    /// The recording as typed.
    pub dataset: PathBuf,
}

impl Metrics {
    /// Reads a run's metrics.
    ///
    /// # Errors
    /// If there are none or they are damaged.
    pub fn read(folder: &RunFolder) -> anyhow::Result<Self> {
        let path = folder.join(METRICS);
        read_json(&path).with_context(|| format!("cannot read {}", path.display()))
    }

    /// Writes them into the run's folder.
    ///
    /// # Errors
    /// If writing fails.
    pub fn write(&self, folder: &RunFolder) -> anyhow::Result<()> {
        folder.write(METRICS, |file| {
            serde_json::to_writer_pretty(&mut *file, self)?;
            Ok(writeln!(file)?)
        })
    }

    /// A small table for people.
    pub fn table(&self) -> String {
        let mut lines = Vec::new();
        let mut line = |name: &str, text: String| lines.push(format!("  {name:<11}{text}"));
        line(
            "frames",
            format!(
                "{} ({} lost, {} damaged, {} dropped), {} keyframes",
                self.frames,
                self.frames_lost,
                self.frames_damaged,
                self.frames_dropped,
                self.keyframes
            ),
        );
        if let (Some(rmse), Some(mean)) = (self.ate_rmse_m, self.ate_mean_m) {
            line(
                "ATE",
                format!("{:.3} cm rmse, {:.3} cm mean", 100.0 * rmse, 100.0 * mean),
            );
        }
        if let (Some(valid), Some(all)) = (self.psnr_valid_depth_db, self.psnr_db) {
            let heldout = self.psnr_heldout_db;
            let heldout = heldout
                .map(|db| format!(", {db:.2} dB held out"))
                .unwrap_or_default();
            line(
                "PSNR",
                format!("{valid:.2} dB where depth is measured, {all:.2} dB everywhere{heldout}"),
            );
        }
        if let (Some(ssim), Some(depth)) = (self.ssim, self.depth_l1_m) {
            line("SSIM", format!("{ssim:.4}"));
            line("depth L1", format!("{:.2} cm", 100.0 * depth));
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
        let megabytes = self.map_bytes as f64 / 1e6;
        line(
            "map",
            format!("{} gaussians, {megabytes:.1} MB", self.num_gaussians),
        );
        lines.join("\n")
    }
}

fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> anyhow::Result<T> {
    Ok(serde_json::from_str(&std::fs::read_to_string(path)?)?)
}
