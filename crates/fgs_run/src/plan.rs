//! One run: what was asked for, checked and opened ([`Plan::resolve`]), then done and saved
//! ([`Plan::run`]).

use std::io::Write;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use fgs_data::{CameraSource, Dataset};
use fgs_files::{OutputFolder, StagedFolder};
use fgs_slam::{Execution, Holdout};

use crate::backend::{Backend, Model};
use crate::drive::drive;
use crate::error::RunError;
use crate::frame_range::FrameRange;
use crate::input::{Input, LiveCamera};
use crate::map_folder::MapFolder;
use crate::observer::{RunEvent, RunObserver};
use crate::pictures;
use crate::recording::{check_size, open_recording, path_from, recording_name, take_camera_file};
use crate::reference;
use crate::report::write_report;
use crate::rescore::{save_scores, without_detours};
use crate::run_folder::{CONFIG, write};
use crate::run_result::RunResult;
use crate::settings::{COMMIT, RunSettings, Settings};

/// Where results go unless a folder is given.
const RUNS: &str = "runs";

/// Of a live camera, resumed.
const NOT_RESUMED: RunError =
    RunError::NotLive("no run with them is resumed, but another one extends its map");

/// What to run. Only `dataset` is needed; what is `None` comes from the settings, or else has the
/// default given here.
#[derive(Clone, Debug, Default)]
pub struct RunOptions {
    /// Folder of the recording. If empty, a run that is resumed takes its own.
    pub dataset: PathBuf,
    /// The map that the run starts with; none.
    pub known_map: Option<KnownMap>,
    /// Seconds between checkpoints of the map (0: after every frame), which are written beside
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
    /// it are replaced when the run has ended. A folder that holds anything else is refused.
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
    /// The recording, or the live camera, as given.
    pub dataset_path: PathBuf,
    /// The recording, as seen from the folder for the results; a live camera as given.
    pub dataset_from_folder: PathBuf,
    /// The recording, or the live camera.
    pub input: Input,
    /// Its frames to run. Of a live camera, from 0 to as many as it may give.
    pub frames: Range<usize>,
    /// All settings, as they will be recorded.
    pub settings: Settings,
    /// How tracker and mapper take turns.
    pub execution: Execution,
    /// Optimisation steps after the last frame.
    pub refine: usize,
    /// Frames that are kept out of the map.
    pub eval_holdout: Option<Holdout>,
    /// Where results go. Nobody else can write there meanwhile.
    pub folder: OutputFolder,
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
        let (known_map, mut settings) = known_map_and_settings(options)?;
        let resumed = resumed(&known_map);
        if resumed.is_some() && settings.run.camera_source.is_some() {
            return Err(NOT_RESUMED);
        }
        let dataset_path = match (&settings.run.dataset, resumed) {
            (Some(own), Some(map)) if options.dataset == Path::new("") => {
                // The run may have left no results yet.
                without_detours(&map.run_folder().join(own))
            }
            _ => options.dataset.clone(),
        };
        let dataset = open_recording(&dataset_path, options.camera.as_deref(), &mut settings)?;
        let frames = options.frames.or(settings.run.frames).unwrap_or_default();
        let frames = frames.resolve(dataset.len())?;
        check_size(&dataset, frames.start)?;
        let execution = options.execution.or(settings.run.mode);
        let execution = execution.unwrap_or(Execution::Lockstep);
        let input = Input::Recording(dataset);
        Self::prepare(
            options,
            known_map,
            settings,
            &dataset_path,
            input,
            frames,
            execution,
        )
    }

    /// The same for a live camera, called `name`, in real time. Its frames end when it ends, after the first
    /// so many of [`RunOptions::frames`], or when the run is stopped.
    ///
    /// # Errors
    /// If anything in the options or the settings is refused, or asks for the frames again.
    pub fn resolve_live(
        options: &RunOptions,
        name: &str,
        source: Box<dyn CameraSource>,
    ) -> Result<(Self, Model), RunError> {
        let (known_map, mut settings) = known_map_and_settings(options)?;
        if resumed(&known_map).is_some() {
            return Err(NOT_RESUMED);
        }
        if options.evaluate {
            return Err(RunError::NotLive(
                "record them, and run the recording, to score by them",
            ));
        }
        if options
            .execution
            .is_some_and(|mode| mode != Execution::Realtime)
        {
            return Err(RunError::NotLive("they are tracked in real time"));
        }
        let frames = options.frames.unwrap_or_default().resolve(usize::MAX)?;
        if frames.start > 0 {
            return Err(RunError::NotLive("a range of them begins with the first"));
        }
        take_camera_file(options.camera.as_deref(), &mut settings)?;
        let camera = match settings.camera {
            Some(camera) if settings.run.camera_overrides == Some(true) => camera,
            _ => source.camera_file().clone(),
        };
        let input = LiveCamera::new(name, source, &camera).map_err(RunError::Camera)?;
        settings.camera = Some(camera);
        let input = Input::Camera(input);
        let mode = Execution::Realtime;
        Self::prepare(
            options,
            known_map,
            settings,
            Path::new(name),
            input,
            frames,
            mode,
        )
    }

    /// Opens the device and the folder for the results, in this order.
    fn prepare(
        options: &RunOptions,
        known_map: Option<(KnownMap, MapFolder)>,
        mut settings: Settings,
        dataset_path: &Path,
        input: Input,
        frames: Range<usize>,
        execution: Execution,
    ) -> Result<(Self, Model), RunError> {
        let recorded = &settings.run;
        let backend = options.backend.or(recorded.backend).unwrap_or_default();
        let model = backend.model(&settings.mapping, options.pipeline_cache.as_deref())?;
        let refine = options.refine.or(recorded.refine).unwrap_or(0);
        let eval_holdout = options.eval_holdout.or(recorded.eval_holdout);
        let checkpoint_every_secs =
            (options.checkpoint_every_secs).or(recorded.checkpoint_every_secs);
        let folder = match (resumed(&known_map), &options.out) {
            (Some(map), _) => OutputFolder::claim(&map.run_folder())?,
            (None, Some(path)) => OutputFolder::claim(path)?,
            (None, None) => {
                OutputFolder::claim_new(Path::new(RUNS), &recording_name(dataset_path))?
            }
        };
        let (dataset_from_folder, dataset_frames) = match &input {
            Input::Recording(dataset) => {
                (path_from(folder.path(), dataset_path), Some(dataset.len()))
            }
            Input::Camera(_) => (dataset_path.to_owned(), None),
        };
        settings.run = RunSettings {
            command: options.command.clone(),
            dataset: dataset_frames.map(|_| dataset_from_folder.clone()),
            dataset_frames,
            camera_source: match &input {
                Input::Recording(_) => None,
                Input::Camera(_) => Some(dataset_path.to_string_lossy().into_owned()),
            },
            mode: Some(execution),
            backend: Some(model.backend),
            frames: match dataset_frames {
                Some(_) => Some(frames.clone().into()),
                None => options.frames,
            },
            refine: (refine > 0).then_some(refine),
            eval_holdout,
            checkpoint_every_secs,
            camera_overrides: settings.run.camera_overrides,
            commit: Some(COMMIT.into()),
        };
        let plan = Self {
            dataset_path: dataset_path.to_owned(),
            dataset_from_folder,
            input,
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

    /// The recording, if the frames come from one.
    pub fn dataset(&self) -> Option<&Dataset> {
        match &self.input {
            Input::Recording(dataset) => Some(dataset),
            Input::Camera(_) => None,
        }
    }

    /// Measures when the sensors take their images as far as the camera file does not say, which takes
    /// seconds, and goes by it from now on; not of a live camera. The settings record it, so that a run
    /// that is repeated, resumed or scored again has the same times. `progress` is called after every frame read; if it
    /// returns false, nothing is changed.
    pub fn measure_sensor_times(&mut self, progress: impl FnMut() -> bool) {
        let Input::Recording(dataset) = &mut self.input else {
            return;
        };
        let times = fgs_sensors::measure(dataset, progress);
        // What no camera can have has not been measured.
        if dataset.set_sensor_times(times).is_ok() && times.are_known() {
            self.settings.camera = Some(dataset.camera_file().clone());
            self.settings.run.camera_overrides = Some(true);
        }
    }

    /// How many frames are to be tracked now, if that is known.
    pub fn num_frames_left(&self) -> Option<usize> {
        (self.frames.end < usize::MAX).then(|| self.frames_left().len())
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
        observer.on(&RunEvent::Mapped {
            map: result.finest_map(),
        });
        self.conclude(result, observer, stop)
    }

    /// Saves everything, then scores if asked to: what is there before scoring, which takes long, is not
    /// lost with it.
    fn conclude(
        &self,
        mut result: RunResult,
        observer: &mut dyn RunObserver,
        stop: &AtomicBool,
    ) -> Result<RunResult, RunError> {
        let mut errors = FirstError(result.checkpoint_failure.take());
        if let Some(dataset) = self.dataset() {
            errors.note(result.score_trajectory(dataset));
        }
        let beside = self.save(&mut result, &mut errors)?;
        if let Some(dataset) = self.dataset().filter(|_| self.evaluate) {
            let folder = beside.as_ref().unwrap_or(&self.folder);
            match result.score_images(dataset, observer, stop) {
                Ok(true) => errors.note(save_scores(&result, dataset, folder)),
                Ok(false) => {}
                Err(error) => errors.note(Err::<(), _>(error)),
            }
        }
        errors.0.map_or(Ok(result), Err)
    }

    /// Saves each result by itself, what is small or cannot be made again first. Earlier results are
    /// replaced only by complete ones; those that are not go into a new folder, which is returned.
    fn save(
        &self,
        result: &mut RunResult,
        errors: &mut FirstError,
    ) -> Result<Option<OutputFolder>, RunError> {
        let results = self
            .folder
            .begin()
            .map_err(|source| RunError::OutputFolder {
                path: self.folder.path().into(),
                source,
            })?;
        let mut write_errors = FirstError::default();
        write_errors.note(result.save_trajectory(&results));
        if let Some(dataset) = self.dataset() {
            write_errors.note(reference::save(result, dataset, &results));
        }
        write_errors.note(self.save_settings(&results));
        write_errors.note(result.save_rows(&results));
        write_errors.note(result.save_map(&results));
        write_errors.note(result.save_refined_map(&results));
        write_errors.note(result.save_further(&results));
        write_errors.note(result.save_up(&results));
        write_errors.note(result.metrics.write(&results));
        if let Some(dataset) = self.dataset() {
            write_errors.note(pictures::write_samples(result, dataset, &results));
        }
        write_errors.note(write_report(&results));
        write_errors.note(self.folder.check());
        let Some(error) = write_errors.0 else {
            results.finish()?;
            return Ok(None);
        };
        let beside = if results.replaces() {
            Some(results.finish_beside()?)
        } else {
            results.finish()?;
            None
        };
        let saved = beside.as_ref().unwrap_or(&self.folder);
        errors.note(Err::<(), _>(RunError::Incomplete {
            source: Box::new(error),
            saved: saved.path().into(),
            kept: beside.as_ref().map(|_| self.folder.path().into()),
        }));
        Ok(beside)
    }

    fn save_settings(&self, results: &StagedFolder<'_>) -> Result<(), RunError> {
        let toml = self.settings.to_toml()?;
        write(results, CONFIG, |file| file.write_all(toml.as_bytes())).map(drop)
    }
}

/// The map that the run starts with, and the settings that apply before the camera is known.
fn known_map_and_settings(
    options: &RunOptions,
) -> Result<(Option<(KnownMap, MapFolder)>, Settings), RunError> {
    let known_map = match &options.known_map {
        Some(known) => Some((known.clone(), MapFolder::open(known.path())?)),
        None => None,
    };
    let settings = match &known_map {
        Some((known, folder)) if options.config.is_none() => {
            let settings = folder.settings()?;
            let settings = match known {
                KnownMap::Resume(_) => settings,
                _ => settings.of_another_run(),
            };
            settings.assigned(&options.assignments)?
        }
        _ => Settings::load(options.config.as_deref(), &options.assignments)?,
    };
    Ok((known_map, settings))
}

/// The map of the run that goes on, if one does.
fn resumed(known_map: &Option<(KnownMap, MapFolder)>) -> Option<&MapFolder> {
    match known_map {
        Some((KnownMap::Resume(_), folder)) => Some(folder),
        _ => None,
    }
}

/// The first of the errors of steps that do not depend on each other.
#[derive(Default)]
struct FirstError(Option<RunError>);

impl FirstError {
    fn note<T, E: Into<RunError>>(&mut self, step: Result<T, E>) {
        if let Err(error) = step {
            self.0.get_or_insert_with(|| error.into());
        }
    }
}

#[cfg(test)]
mod live_tests;
#[cfg(test)]
mod tests;
