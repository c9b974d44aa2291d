//! Scores a finished run again, from its folder and its recording.

use std::path::{Component, Path, PathBuf};
use std::sync::atomic::AtomicBool;

use fgs_data::Dataset;
use fgs_files::OutputFolder;

use crate::error::RunError;
use crate::frame_log::FrameRow;
use crate::observer::RunObserver;
use crate::pictures;
use crate::recording::open_recording;
use crate::reference;
use crate::report::write_report;
use crate::run_folder::{CONFIG, FRAMES, METRICS, PICTURES, REFERENCE, REPORT, RunFolder};
use crate::run_result::RunResult;
use crate::score_values::Scores;
use crate::settings::Settings;

/// Times are written with all digits, but read twice.
const MAX_TIME_ERROR_SECS: f64 = 1e-6;

/// The folder of a finished run and the recording that it was made from.
pub struct FinishedRun {
    folder: RunFolder,
    dataset: Dataset,
}

impl FinishedRun {
    /// Opens the folder of a run, and its recording: where `recording` says, else where it was during
    /// the run.
    ///
    /// # Errors
    /// If the folder is not that of a run, or the recording cannot be opened or is another one.
    pub fn open(path: &Path, recording: Option<&Path>) -> Result<Self, RunError> {
        let folder = RunFolder::open(path)?;
        let config = folder.join(CONFIG);
        let mut settings = Settings::read(&config)?;
        let recording = match (recording, &settings.run.dataset) {
            (Some(path), _) => path.to_owned(),
            (None, Some(recorded)) => from_folder(path, recorded),
            (None, None) => return Err(RunError::UnknownRecording { path: config }),
        };
        let overridden = settings.run.camera_overrides == Some(true);
        settings.run.camera_overrides = Some(true);
        let open = |settings: &mut Settings| {
            open_recording(&recording, None, settings)
                .map_err(|error| RunError::RecordingOfRun(Box::new(error)))
        };
        let dataset = open(&mut settings)?;
        let rows = RunResult::read_rows(&folder)?;
        let mut differences = difference(&dataset, &rows, settings.run.dataset_frames);
        if !overridden {
            let mut own = settings.clone();
            own.run.camera_overrides = None;
            if open(&mut own)?.camera_file() != dataset.camera_file() {
                differences.get_or_insert("its camera is another".into());
            }
        }
        match differences {
            None => Ok(Self { folder, dataset }),
            Some(difference) => Err(RunError::OtherRecording {
                path: recording,
                difference,
            }),
        }
    }

    /// The recording.
    pub fn dataset(&self) -> &Dataset {
        &self.dataset
    }

    /// Compares trajectory and map with the recording, and writes `metrics.json`, `frames.csv`,
    /// the pictures and the page anew. What cannot be scored has no score then. `None` if it was
    /// stopped; then nothing is changed.
    ///
    /// # Errors
    /// If a result cannot be read, scored or written.
    pub fn rescore(
        &self,
        observer: &mut dyn RunObserver,
        stop: &AtomicBool,
    ) -> Result<Option<RunResult>, RunError> {
        // That nothing can be written shows before the work.
        let output = OutputFolder::claim_any(self.folder.path())?;
        let mut result = RunResult::read(&self.folder)?;
        result.metrics.scores = Scores::default();
        if let Some(refined) = &mut result.metrics.refined {
            refined.scores = Scores::default();
        }
        for row in &mut result.rows {
            row.scores = Scores::default();
        }
        result.score_trajectory(&self.dataset)?;
        if !result.score_images(&self.dataset, observer, stop)? {
            return Ok(None);
        }
        save_scores(&result, &self.dataset, &output)?;
        Ok(Some(result))
    }
}

/// Saves what scoring changes, and leaves everything else in the folder as it is.
pub(crate) fn save_scores(
    result: &RunResult,
    dataset: &Dataset,
    folder: &OutputFolder,
) -> Result<(), RunError> {
    let io_error = |source| RunError::OutputFolder {
        path: folder.path().into(),
        source,
    };
    let results = folder.begin().map_err(io_error)?;
    results
        .carry_over(&[METRICS, FRAMES, PICTURES, REFERENCE, REPORT])
        .map_err(io_error)?;
    result.save_rows(&results)?;
    result.metrics.write(&results)?;
    reference::save(result, dataset, &results)?;
    pictures::write_samples(result, dataset, &results)?;
    write_report(&results)?;
    Ok(results.finish()?)
}

/// Where a path leads that is seen from a run's folder, or from the current one as runs once
/// recorded it.
fn from_folder(folder: &Path, recorded: &Path) -> PathBuf {
    let real = folder.canonicalize().map(|real| real.join(recorded));
    match real.and_then(|path| path.canonicalize()) {
        Ok(path) => path,
        Err(_) if recorded.exists() => recorded.to_owned(),
        Err(_) => without_detours(&folder.join(recorded)),
    }
}

/// `runs/desk/../../room` is `room`.
pub(crate) fn without_detours(path: &Path) -> PathBuf {
    let mut short = PathBuf::new();
    for part in path.components() {
        let is_name = matches!(short.components().next_back(), Some(Component::Normal(_)));
        if part == Component::ParentDir && is_name {
            short.pop();
        } else {
            short.push(part);
        }
    }
    short
}

/// How a recording differs from the one that has these rows.
fn difference(dataset: &Dataset, rows: &[FrameRow], frames: Option<usize>) -> Option<String> {
    let len = dataset.len();
    if let Some(frames) = frames.filter(|frames| *frames != len) {
        return Some(format!("it has {len} frames, and the run's had {frames}"));
    }
    let times: Vec<f64> = dataset.timestamps().collect();
    rows.iter().find_map(|row| match times.get(row.index) {
        None => Some(format!(
            "it has {len} frames, and the run saw frame {}",
            row.index
        )),
        Some(time) => {
            let recorded = row.timestamp_secs?;
            let differs = (time - recorded).abs() > MAX_TIME_ERROR_SECS;
            differs.then(|| format!("its frame {} has another time", row.index))
        }
    })
}
