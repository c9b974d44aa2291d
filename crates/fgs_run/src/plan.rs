//! One run: what was asked for, checked and opened ([`Plan::resolve`]), then done and saved
//! ([`Plan::run`]).

use std::io::Write;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use fgs_data::{DataError, Dataset};
use fgs_slam::{Execution, Holdout};

use crate::backend::{Backend, Model};
use crate::drive::drive;
use crate::error::RunError;
use crate::frame_range::FrameRange;
use crate::map_folder::MapFolder;
use crate::observer::RunObserver;
use crate::pictures;
use crate::recording::{check_size, open_recording, recording_name};
use crate::reference;
use crate::report::write_report;
use crate::run_folder::{CONFIG, RunFolder, TRAJECTORY};
use crate::run_result::RunResult;
use crate::settings::{COMMIT, RunSettings, Settings};

/// Where results go unless a folder is given.
const RUNS: &str = "runs";

/// What to run. Only `dataset` is needed; what is `None` comes from the settings, or else has the
/// default given here.
#[derive(Clone, Debug, Default)]
pub struct RunOptions {
    /// Folder of the recording. If empty, a run that is resumed takes its own.
    pub dataset: PathBuf,
    /// The map that the run starts with; none.
    pub known_map: Option<KnownMap>,
    /// Seconds between checkpoints of the map (0: after every frame), which are written to [`MAP_FOLDER`](crate::MAP_FOLDER) in
    /// the folder for the results; none are written.
    pub checkpoint_every_secs: Option<u64>,
    /// Settings file; see [`Settings`].
    pub config: Option<PathBuf>,
    /// Single settings `key=value`, which override the file's.
    pub assignments: Vec<String>,
    /// Camera file; takes precedence over the recording's own camera.
    pub camera: Option<PathBuf>,
    /// How tracker and mapper take turns; lockstep.
    pub execution: Option<Execution>,
    /// Where the map is optimised; [`Backend::Auto`].
    pub backend: Option<Backend>,
    /// Which frames; all.
    pub frames: Option<FrameRange>,
    /// Optimisation steps after the last frame, with all keyframes alike, which give a second map; 0.
    pub refine: Option<usize>,
    /// Frames that are tracked but kept out of the map, to judge it by; none.
    pub eval_holdout: Option<Holdout>,
    /// Folder for the results; the first free of `runs/NAME`, `runs/NAME-2`, ... Results already in
    /// it are replaced when the run has ended.
    pub out: Option<PathBuf>,
    /// Whether to render and score every tracked frame at the end.
    pub evaluate: bool,
    /// Folder in which a graphics device's compiled shaders are kept from one run to the next; none.
    pub pipeline_cache: Option<PathBuf>,
    /// The command line, to be recorded with the settings.
    pub command: Option<String>,
}

/// A map that is known before a run, in its folder or in that of its run.
#[derive(Clone, Debug)]
pub enum KnownMap {
    /// The run that made it goes on where its last checkpoint is, with its settings and in its folder.
    Resume(PathBuf),
    /// The camera is lost in it, and extends it once it is found. Settings are the map's where none are
    /// given.
    Extend(PathBuf),
    /// The camera is lost in it, and is only to be followed: the map stays as it is.
    LocalizeOnly(PathBuf),
}

impl KnownMap {
    fn path(&self) -> &Path {
        match self {
            Self::Resume(path) | Self::Extend(path) | Self::LocalizeOnly(path) => path,
        }
    }
}

/// Everything that a run needs, checked and opened.
pub struct Plan {
    /// The recording as given.
    pub dataset_path: PathBuf,
    /// The recording.
    pub dataset: Dataset,
    /// Its frames to run.
    pub frames: Range<usize>,
    /// All settings, as they will be recorded.
    pub settings: Settings,
    /// How tracker and mapper take turns.
    pub execution: Execution,
    /// Optimisation steps after the last frame.
    pub refine: usize,
    /// Frames that are kept out of the map.
    pub eval_holdout: Option<Holdout>,
    /// Where results go.
    pub folder: RunFolder,
    /// Whether to render and score every tracked frame at the end.
    pub evaluate: bool,
    /// Seconds between checkpoints of the map.
    pub checkpoint_every_secs: Option<u64>,
    /// The map that the run starts with, and what it is for.
    pub known_map: Option<(KnownMap, MapFolder)>,
}

impl Plan {
    /// Opens the map if one is known, the recording, the device and the folder for the results, in this
    /// order: where one is refused, nothing has been written.
    ///
    /// # Errors
    /// If anything in the options, the settings or the recording is refused.
    pub fn resolve(options: &RunOptions) -> Result<(Self, Model), RunError> {
        let known_map = match &options.known_map {
            Some(known) => Some((known.clone(), MapFolder::open(known.path())?)),
            None => None,
        };
        let resumed = match &known_map {
            Some((KnownMap::Resume(_), folder)) => Some(folder),
            _ => None,
        };
        let mut settings = match &known_map {
            Some((_, folder)) if options.config.is_none() => {
                let settings = folder.settings()?;
                let settings = match resumed {
                    Some(_) => settings,
                    None => settings.of_another_run(),
                };
                settings.assigned(&options.assignments)?
            }
            _ => Settings::load(options.config.as_deref(), &options.assignments)?,
        };
        let dataset_path = match (&settings.run.dataset, resumed) {
            (Some(own), Some(_)) if options.dataset == Path::new("") => own.clone(),
            _ => options.dataset.clone(),
        };
        let dataset = open_recording(&dataset_path, options.camera.as_deref(), &mut settings)?;
        let recorded = &settings.run;
        let frames = options.frames.or(recorded.frames).unwrap_or_default();
        let frames = frames.resolve(dataset.len())?;
        check_size(&dataset, frames.start)?;
        let execution = options.execution.or(recorded.mode);
        let execution = execution.unwrap_or(Execution::Lockstep);
        let backend = options.backend.or(recorded.backend).unwrap_or_default();
        let model = backend.model(&settings.mapping, options.pipeline_cache.as_deref())?;
        let refine = options.refine.or(recorded.refine).unwrap_or(0);
        let eval_holdout = options.eval_holdout.or(recorded.eval_holdout);
        let checkpoint_every_secs =
            (options.checkpoint_every_secs).or(recorded.checkpoint_every_secs);
        settings.run = RunSettings {
            command: options.command.clone(),
            dataset: Some(dataset_path.clone()),
            mode: Some(execution),
            backend: Some(model.backend),
            frames: Some(frames.clone().into()),
            refine: (refine > 0).then_some(refine),
            eval_holdout,
            checkpoint_every_secs,
            camera_overrides: settings.run.camera_overrides,
            commit: Some(COMMIT.into()),
        };
        let folder = match (resumed, &options.out) {
            (Some(map), _) => RunFolder::create(&map.run_folder())?,
            (None, Some(path)) => RunFolder::create(path)?,
            (None, None) => RunFolder::create_new(Path::new(RUNS), &recording_name(&dataset_path))?,
        };
        let plan = Self {
            dataset_path,
            dataset,
            frames,
            settings,
            execution,
            refine,
            eval_holdout,
            folder,
            evaluate: options.evaluate,
            checkpoint_every_secs,
            known_map,
        };
        Ok((plan, model))
    }

    /// The frames that are to be tracked now.
    pub fn frames_left(&self) -> Range<usize> {
        match &self.known_map {
            Some((KnownMap::Resume(_), folder)) => folder.next_frame()..self.frames.end,
            _ => self.frames.clone(),
        }
    }

    /// Tracks and maps, saves, and scores if asked to. When `stop` is set or the mapper fails
    /// (`metrics.failure`), the run ends early and is saved like any other.
    ///
    /// # Errors
    /// If the run cannot be started or no frame can be read; then nothing is saved. If a result cannot
    /// be scored or saved: then everything else is, and the first such error is returned.
    pub fn run(
        &self,
        model: Model,
        observer: &mut dyn RunObserver,
        stop: &AtomicBool,
    ) -> Result<RunResult, RunError> {
        let result = drive(self, model, observer, stop)?;
        self.conclude(result, observer, stop)
    }

    /// Saves each result by itself, what is small or cannot be made again first: the trajectory before
    /// the map, and both before scoring.
    fn conclude(
        &self,
        mut result: RunResult,
        observer: &mut dyn RunObserver,
        stop: &AtomicBool,
    ) -> Result<RunResult, RunError> {
        let folder = &self.folder;
        let mut errors = FirstError(result.checkpoint_failure.take());
        folder.clear_results();
        errors.note(self.save_settings());
        errors.note(save_trajectory(&result, folder));
        errors.note(reference::save(&result, &self.dataset, folder));
        errors.note(result.save_rows(folder));
        errors.note(result.score_trajectory(&self.dataset));
        errors.note(result.save_map(folder));
        errors.note(result.save_refined_map(folder));
        errors.note(result.metrics.write(folder));
        if self.evaluate {
            errors.note(result.score_images(&self.dataset, observer, stop));
            errors.note(result.save_rows(folder));
            errors.note(result.metrics.write(folder));
        }
        errors.note(pictures::write_samples(&result, &self.dataset, folder));
        errors.note(write_report(folder));
        errors.0.map_or(Ok(result), Err)
    }

    fn save_settings(&self) -> Result<(), RunError> {
        let toml = self.settings.to_toml()?;
        self.folder
            .write(CONFIG, |file| file.write_all(toml.as_bytes()))
    }
}

fn save_trajectory(result: &RunResult, folder: &RunFolder) -> Result<(), DataError> {
    result.trajectory.write(&folder.join(TRAJECTORY))
}

/// The first of the errors of steps that do not depend on each other.
struct FirstError(Option<RunError>);

impl FirstError {
    fn note<T, E: Into<RunError>>(&mut self, step: Result<T, E>) {
        if let Err(error) = step {
            self.0.get_or_insert_with(|| error.into());
        }
    }
}

#[cfg(test)]
mod tests;
