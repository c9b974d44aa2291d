//! Scores a finished run again, from its folder and its recording.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use fgs_data::Dataset;

use crate::error::RunError;
use crate::observer::RunObserver;
use crate::pictures;
use crate::recording::open_recording;
use crate::reference;
use crate::report::write_report;
use crate::run_folder::{CONFIG, RunFolder};
use crate::run_result::RunResult;
use crate::settings::Settings;

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
    /// If the folder is not that of a run, or the recording cannot be opened.
    pub fn open(path: &Path, recording: Option<&Path>) -> Result<Self, RunError> {
        let folder = RunFolder::open(path)?;
        let config = folder.join(CONFIG);
        let mut settings = Settings::read(&config)?;
        let recording = recording
            .map(Path::to_owned)
            .or(settings.run.dataset.clone())
            .ok_or(RunError::UnknownRecording { path: config })?;
        settings.run.camera_overrides = Some(true);
        let dataset = open_recording(&recording, None, &mut settings)
            .map_err(|error| RunError::RecordingOfRun(Box::new(error)))?;
        Ok(Self { folder, dataset })
    }

    /// The recording.
    pub fn dataset(&self) -> &Dataset {
        &self.dataset
    }

    /// Compares trajectory and map with the recording, and writes `metrics.json`, `frames.csv`,
    /// the pictures and the page anew. `None` if it was stopped; then nothing is changed.
    ///
    /// # Errors
    /// If a result cannot be read, scored or written.
    pub fn rescore(
        &self,
        observer: &mut dyn RunObserver,
        stop: &AtomicBool,
    ) -> Result<Option<RunResult>, RunError> {
        // That nothing can be written shows before the work.
        RunFolder::create(self.folder.path())?;
        let mut result = RunResult::read(&self.folder)?;
        result.score_trajectory(&self.dataset)?;
        if !result.score_images(&self.dataset, observer, stop)? {
            return Ok(None);
        }
        pictures::write_samples(&result, &self.dataset, &self.folder)?;
        result.save_rows(&self.folder)?;
        result.metrics.write(&self.folder)?;
        reference::save(&result, &self.dataset, &self.folder)?;
        write_report(&self.folder)?;
        Ok(Some(result))
    }
}
