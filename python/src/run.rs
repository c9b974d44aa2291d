//! Whole runs, as `fgs run` does them.

use std::path::PathBuf;

use fgs_run::{
    Backend, Metrics, Plan, RunEvent, RunFolder, RunObserver, RunOptions, RunResult,
    pipeline_cache_folder,
};
use fgs_sensors::frames_to_measure;
use fgs_slam::{Execution, Holdout};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::config::{Config, assignments};
use crate::errors::{IntoPython, RunFailure, SettingError};
use crate::gaussians::Gaussians;
use crate::interrupt::{Desk, interruptible};
use crate::options;
use crate::trajectory::Trajectory;

/// Tracks and maps a whole recording, as ``fgs run`` does, and writes a folder of results.
///
/// In lockstep mode, the default, the results are those of ``fgs run`` byte for byte. Ctrl-C ends the run and saves it
/// before KeyboardInterrupt is raised, and so does an exception of `progress`.
///
/// Args:
///     dataset: folder of the recording.
///     out: folder for the results; the first free of ``runs/NAME``, ``runs/NAME-2``, ... if left out.
///     config: a :class:`Config` or a settings file.
///     camera: a camera file that overrides the recording's own.
///     mode: ``"lockstep"``, ``"parallel"`` or ``"realtime"``.
///     backend: ``"auto"``, ``"cpu"`` or ``"gpu"``.
///     frames: first frame, and the one after the last.
///     refine: so many more optimisation steps after the last frame make a second map.
///     evaluate: render and score every frame at the end.
///     eval_holdout: track the last of every so many frames but keep it out of the map.
///     progress: called as ``progress(what, done, total)``, where `what` is ``"sensor times"``, ``"frames"``,
///         ``"refinement"`` or ``"evaluation"``.
///     **settings: single settings, as for :class:`Config`; they go over `config`.
///
/// Raises:
///     SettingError: a setting is unknown or impossible.
///     DatasetError: the recording cannot be read.
///     DeviceError: there is no GPU, and one was asked for.
///     FileError: the results cannot be written.
///     RunError: the run failed on its way; the message says where the results so far are.
#[pyfunction]
#[pyo3(signature = (
    dataset, *, out = None, config = None, camera = None, mode = None, backend = None, frames = None,
    refine = None, evaluate = false, eval_holdout = None, progress = None, **settings
))]
#[allow(clippy::too_many_arguments, reason = "keywords in Python")]
pub fn run(
    py: Python<'_>,
    dataset: PathBuf,
    out: Option<PathBuf>,
    config: Option<&Bound<'_, PyAny>>,
    camera: Option<PathBuf>,
    mode: Option<&str>,
    backend: Option<&str>,
    frames: Option<(usize, usize)>,
    refine: Option<usize>,
    evaluate: bool,
    eval_holdout: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
    settings: Option<&Bound<'_, PyDict>>,
) -> PyResult<Run> {
    let (config, mut all) = match config.map(|config| (config, config.cast::<Config>())) {
        None => (None, Vec::new()),
        Some((_, Ok(config))) => (config.get().file.clone(), config.get().assignments.clone()),
        Some((file, Err(_))) => (Some(file.extract()?), Vec::new()),
    };
    all.extend(assignments(settings)?);
    let eval_holdout = eval_holdout.map(Holdout::every).transpose();
    let run_options = RunOptions {
        dataset,
        config,
        assignments: all,
        camera,
        execution: options::parsed::<Execution>("mode", mode)?,
        backend: options::parsed::<Backend>("backend", backend)?,
        frames: frames.map(|(first, end)| (first..end).into()),
        refine,
        eval_holdout: eval_holdout
            .map_err(|error| SettingError::new_err(format!("eval_holdout: {error}")))?,
        out,
        evaluate,
        pipeline_cache: pipeline_cache_folder(),
        ..RunOptions::default()
    };
    interruptible(py, progress, |desk| run_to_end(&run_options, desk))
}

fn run_to_end(options: &RunOptions, desk: &Desk<'_>) -> PyResult<Run> {
    let (mut plan, model) = Plan::resolve(options).map_err(IntoPython::into_python)?;
    let unknown = plan
        .dataset()
        .filter(|dataset| !dataset.camera_file().sensor_times().are_known());
    if let Some(dataset) = unknown {
        let (mut done, total) = (0, frames_to_measure(dataset));
        plan.measure_sensor_times(|| {
            done += 1;
            desk.report(("sensor times", done, total));
            desk.goes_on()
        });
    }
    let mut observer = Reporter {
        desk,
        done: 0,
        total: plan.frames_left().len(),
    };
    let result = plan.run(model, &mut observer, desk.stop);
    let result = result.map_err(IntoPython::into_python)?;
    let path = plan.folder.path();
    match result.metrics.failure {
        Some(failure) => Err(RunFailure::new_err(format!(
            "the run ended early: {failure}; the results so far are in {}",
            path.display()
        ))),
        None => Ok(Run { path: path.into() }),
    }
}

/// Tells how far a run is.
struct Reporter<'a> {
    desk: &'a Desk<'a>,
    /// Frames so far.
    done: usize,
    total: usize,
}

impl RunObserver for Reporter<'_> {
    fn on(&mut self, event: &RunEvent<'_>) {
        let progress = match *event {
            RunEvent::Frame { .. } => {
                self.done += 1;
                ("frames", self.done, self.total)
            }
            RunEvent::Refined { done, total } => ("refinement", done, total),
            RunEvent::Scored { done, total } => ("evaluation", done, total),
            _ => return,
        };
        self.desk.report(progress);
    }
}

/// The folder of a finished run.
///
/// Args:
///     path: the folder that :func:`run` or ``fgs run`` wrote.
///
/// Raises:
///     FileError: it is not the folder of a run.
#[pyclass(frozen, module = "fgs_slam")]
pub struct Run {
    pub path: PathBuf,
}

impl Run {
    fn read(&self, py: Python<'_>) -> PyResult<RunResult> {
        py.detach(|| RunResult::read(&RunFolder::open(&self.path)?))
            .map_err(IntoPython::into_python)
    }
}

#[pymethods]
impl Run {
    #[new]
    fn new(path: PathBuf) -> PyResult<Self> {
        RunFolder::open(&path).map_err(IntoPython::into_python)?;
        Ok(Self { path })
    }

    /// The folder.
    #[getter]
    fn path(&self) -> PathBuf {
        self.path.clone()
    }

    /// Reads the numbers of ``metrics.json``; ``psnr_valid_depth_db`` and the like are there once frames are scored.
    ///
    /// Raises:
    ///     FileError: the file is missing or damaged.
    fn metrics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let metrics = RunFolder::open(&self.path).and_then(|folder| Metrics::read(&folder));
        let metrics = serde_json::to_string(&metrics.map_err(IntoPython::into_python)?);
        let text = metrics.map_err(|error| RunFailure::new_err(error.to_string()))?;
        py.import("json")?.call_method1("loads", (text,))
    }

    /// Reads the poses of the frames that are not lost.
    ///
    /// Raises:
    ///     DatasetError: the file is missing or damaged.
    fn trajectory(&self) -> PyResult<Trajectory> {
        let path = self.path.join(fgs_run::TRAJECTORY);
        let trajectory = fgs_data::Trajectory::read(&path);
        trajectory.map(Trajectory).map_err(IntoPython::into_python)
    }

    /// Reads where the camera was in truth, in the run's coordinates; None if the recording does not say it.
    ///
    /// Raises:
    ///     DatasetError: the file is damaged.
    fn reference(&self) -> PyResult<Option<Trajectory>> {
        let path = self.path.join(fgs_run::REFERENCE);
        let read = || fgs_data::Trajectory::read(&path).map(Trajectory);
        path.is_file()
            .then(read)
            .transpose()
            .map_err(IntoPython::into_python)
    }

    /// Reads the map, the refined one if there is one.
    ///
    /// Raises:
    ///     FileError: the file is missing or damaged.
    fn gaussians(&self, py: Python<'_>) -> PyResult<Gaussians> {
        let result = self.read(py)?;
        Gaussians::from_rust(py, result.refined.unwrap_or(result.gaussians))
    }

    /// Reads the verdict on each frame: ``"tracked"``, ``"weak"``, ``"lost"``, ``"damaged"`` or ``"dropped"``.
    ///
    /// Raises:
    ///     FileError: the file is missing or damaged.
    fn verdicts(&self) -> PyResult<Vec<String>> {
        let rows = RunFolder::open(&self.path).and_then(|folder| RunResult::read_rows(&folder));
        let rows = rows.map_err(IntoPython::into_python)?;
        Ok(rows.iter().map(|row| row.status.to_string()).collect())
    }

    fn __repr__(&self) -> String {
        format!("Run({:?})", self.path.display().to_string())
    }
}
