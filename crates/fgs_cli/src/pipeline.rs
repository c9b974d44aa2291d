//! One run from an opened recording to a saved folder.

use std::ops::Range;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, bail};
use fgs_data::{Dataset, Trajectory};
use fgs_slam::{Execution, SlamOutput};
use fgs_splat::GaussianModel;
use serde_json::json;

use crate::backend::Model;
use crate::console::Console;
use crate::failure::{EXIT_DONE, EXIT_INTERRUPTED};
use crate::frame_log::{FrameRow, FrameStatus};
use crate::metrics::Metrics;
use crate::mode::Mode;
use crate::progress::RunObserver;
use crate::run_folder::RunFolder;
use crate::run_result::RunResult;
use crate::settings::{COMMIT, Settings};
use crate::{evaluation, memory, pictures};

/// Everything that a run needs, resolved from what the user typed.
pub struct Plan {
    /// The recording as typed.
    pub dataset_path: PathBuf,
    /// The recording.
    pub dataset: Dataset,
    /// Its frames.
    pub frames: Range<usize>,
    /// All settings, as they will be recorded.
    pub settings: Settings,
    /// How tracker and mapper take turns.
    pub mode: Mode,
    /// Where results go.
    pub folder: RunFolder,
    /// Whether to render and score every frame at the end.
    pub evaluate: bool,
}

impl Plan {
    /// Runs, saves, evaluates if asked to, and reports; returns the exit code. When `stop` is set or
    /// the mapper fails, the run ends early and is saved like any other.
    ///
    /// # Errors
    /// If no frame can be read, the mapper fails or something cannot be saved.
    pub fn execute(&self, model: Model, console: Console, stop: &AtomicBool) -> anyhow::Result<u8> {
        self.announce(&model, console);
        let name = model.name().to_owned();
        let result = match model {
            Model::Cpu { model, .. } => self.track_and_map(*model, name, console, stop),
            Model::Gpu { model, .. } => self.track_and_map(*model, name, console, stop),
        };
        self.conclude(result?, console, stop)
    }

    fn conclude(
        &self,
        mut result: RunResult,
        console: Console,
        stop: &AtomicBool,
    ) -> anyhow::Result<u8> {
        evaluation::score_trajectory(&mut result, &self.dataset)?;
        result.save(&self.folder, &self.settings)?;
        if self.evaluate && evaluation::score_images(&mut result, &self.dataset, console, stop)? {
            result.save_numbers(&self.folder)?;
        }
        pictures::write_samples(&result, &self.dataset, &self.folder)?;
        console.event("metrics", &result.metrics);
        console.say(result.metrics.table());
        console.say(format!("  results    {}", self.folder.path().display()));
        if let Some(failure) = &result.metrics.failure {
            let frame = result.rows.last().map_or(0, |row| row.index);
            let folder = self.folder.path().display();
            bail!(
                "the run ended early, at frame {frame}: {failure}; what there was is in {folder}"
            );
        }
        let interrupted = stop.load(Ordering::Relaxed);
        Ok(if interrupted {
            EXIT_INTERRUPTED
        } else {
            EXIT_DONE
        })
    }

    fn announce(&self, model: &Model, console: Console) {
        let camera = self.dataset.camera();
        let format = self.dataset.format().to_string();
        let (dataset, out) = (self.dataset_path.display(), self.folder.path());
        console.event(
            "start",
            json!({
                "dataset": self.dataset_path,
                "format": format,
                "frames": self.frames,
                "width": camera.width,
                "height": camera.height,
                "backend": model.name(),
                "out": out,
            }),
        );
        console.say(format!(
            "{dataset}: {format}, frames {}..{} of {}, {}x{}",
            self.frames.start,
            self.frames.end,
            self.dataset.len(),
            camera.width,
            camera.height
        ));
        console.say(format!("computing on {model}"));
    }

    fn track_and_map(
        &self,
        model: impl GaussianModel,
        backend: String,
        console: Console,
        stop: &AtomicBool,
    ) -> anyhow::Result<RunResult> {
        let config = self.settings.slam();
        let mut observer = RunObserver::new(&self.frames, console);
        let output = fgs_slam::run(
            self.dataset.frames(self.frames.clone()),
            self.dataset.camera(),
            &config,
            Execution::from(self.mode),
            model,
            &mut observer,
            stop,
        )?;
        let rows = observer.into_rows();
        if output.frames_damaged > 0 && output.frames_damaged == rows.len() {
            bail!("none of the {} frames could be read", rows.len());
        }
        let poses = output.frames.iter();
        let trajectory = Trajectory::new(
            poses.filter_map(|frame| Some((frame.timestamp_secs, frame.world_from_camera?))),
        )
        .context("the estimated trajectory is damaged")?;
        Ok(RunResult {
            metrics: self.metrics(&rows, &output, backend, stop),
            rows,
            trajectory,
            gaussians: output.gaussians,
        })
    }

    fn metrics(
        &self,
        rows: &[FrameRow],
        output: &SlamOutput,
        backend: String,
        stop: &AtomicBool,
    ) -> Metrics {
        let count = |status| rows.iter().filter(|row| row.status == status).count();
        let read = output.frames.len();
        let per_frame = |total: f64| (read > 0).then(|| total / read as f64);
        let seconds = output.timings.total.as_secs_f64();
        Metrics {
            frames: rows.len(),
            frames_dropped: count(FrameStatus::Dropped),
            frames_lost: count(FrameStatus::Lost),
            frames_damaged: count(FrameStatus::Damaged),
            interrupted: stop.load(Ordering::Relaxed),
            failure: output.failure.as_ref().map(ToString::to_string),
            ate_rmse_m: None,
            ate_mean_m: None,
            rpe_mean_m: None,
            psnr_valid_depth_db: None,
            psnr_db: None,
            psnr_paper_db: None,
            psnr_heldout_db: None,
            ssim: None,
            depth_l1_m: None,
            lpips: None,
            fps: (seconds > 0.0).then(|| rows.len() as f64 / seconds),
            tracking_ms: evaluation::mean(rows.iter().filter_map(|row| row.tracking_ms)),
            mapping_ms: per_frame(1e3 * output.timings.mapping.as_secs_f64()),
            iterations: output.timings.steps,
            iterations_per_frame: per_frame(output.timings.steps as f64),
            keyframes: output.keyframes.len(),
            num_gaussians: output.gaussians.len(),
            map_bytes: 0,
            peak_rss_bytes: memory::peak_rss_bytes(),
            device_bytes: output.device_bytes,
            seed: self.settings.slam().seed,
            commit: COMMIT.into(),
            mode: self.mode,
            backend,
            threads: rayon::current_num_threads(),
            dataset: self.dataset_path.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use fgs_data::OpenOptions;
    use fgs_splat::CpuModel;
    use fgs_synth::{SensorModel, Sequence, kinect_camera};

    use super::*;

    #[test]
    fn a_run_that_failed_on_its_way_is_saved_and_says_so() {
        let folder = tempfile::tempdir().unwrap();
        let recording = folder.path().join("room");
        let camera = kinect_camera(160, 120).unwrap();
        let sequence = Sequence::new(1, 3, camera, SensorModel::exact());
        fgs_synth::write_tum(&sequence, &recording, |_| {
            std::ops::ControlFlow::Continue(())
        })
        .unwrap();
        let dataset = Dataset::open(&recording, &OpenOptions::default()).unwrap();
        let plan = Plan {
            frames: 0..dataset.len(),
            dataset_path: recording,
            dataset,
            settings: Settings::default(),
            mode: Mode::Lockstep,
            folder: RunFolder::create(&folder.path().join("out")).unwrap(),
            evaluate: true,
        };
        let (console, stop) = (Console::Machines, AtomicBool::new(false));
        let model = CpuModel::default();
        let mut result = plan
            .track_and_map(model, "a device".into(), console, &stop)
            .unwrap();
        assert_eq!(result.metrics.failure, None);
        result.metrics.failure = Some("unplugged".into());
        let error = plan.conclude(result, console, &stop).unwrap_err();
        assert_eq!(crate::failure::exit_code(&error), 1);
        let message = error.to_string();
        assert!(
            message.starts_with("the run ended early, at frame 2: unplugged; what there was is in"),
            "{message}"
        );
        let saved = RunResult::read(&plan.folder).unwrap();
        assert_eq!(saved.metrics.failure.as_deref(), Some("unplugged"));
        assert_eq!(saved.metrics.backend, "a device");
        assert!(saved.rows.len() == 3 && saved.gaussians.len() > 100);
        assert!(saved.metrics.psnr_db.is_some());
    }
}
