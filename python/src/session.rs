//! A session: frames in, one by one; poses and a map out.

use std::sync::Mutex;

use fgs_data::DataError;
use fgs_geom::{FrameIndex, RgbdFrame, View};
use fgs_run::{Backend, pipeline_cache_folder};
use fgs_slam::{Execution, SlamOutput};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyDict;

use crate::arrays;
use crate::camera::Camera;
use crate::config::Config;
use crate::errors::{FrameError, IntoPython, SessionError};
use crate::gaussians::{Gaussians, Render};
use crate::interrupt::interruptible;
use crate::options;
use crate::pose::{Pose, pose_of};
use crate::trajectory::Trajectory;

/// Follows a camera and maps what it sees, frame by frame.
///
/// Other Python threads run while it computes. Calls from several threads take turns.
///
/// Args:
///     config: the settings.
///     camera: the camera of every frame.
///     mode: ``"lockstep"`` (the same result, bit for bit, every time; the default), ``"parallel"`` or ``"realtime"``
///         (beside a live camera).
///     backend: where the map is optimised: ``"cpu"``, ``"gpu"`` or ``"auto"`` (a GPU if there is one; the default).
///
/// Raises:
///     SettingError: a setting is not possible.
///     DeviceError: there is no GPU, and one was asked for.
#[pyclass(frozen, module = "fgs_slam")]
pub struct Slam {
    camera: fgs_geom::Camera,
    /// None once it is finished. Locked only while Python is released.
    session: Mutex<Option<Session>>,
    /// What it found, once it is finished.
    result: PyOnceLock<Py<SlamResult>>,
}

struct Session {
    slam: fgs_slam::Slam,
    /// Frames so far, and the time of the last.
    frames: usize,
    last_secs: f64,
}

impl Slam {
    /// Does something with the session, with Python released.
    fn with<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut Session) -> PyResult<T> + Send,
    ) -> PyResult<T> {
        py.detach(|| match self.session.lock() {
            Ok(mut session) => work(session.as_mut().ok_or_else(finished)?),
            Err(_) => Err(broken()),
        })
    }

    fn map(&self, py: Python<'_>) -> PyResult<fgs_splat::Gaussians> {
        self.with(py, |session| {
            session.slam.snapshot().map_err(IntoPython::into_python)
        })
    }
}

fn finished() -> PyErr {
    SessionError::new_err("the session is finished")
}

fn broken() -> PyErr {
    SessionError::new_err("the session stopped on an internal error")
}

#[pymethods]
impl Slam {
    #[new]
    #[pyo3(signature = (config, camera, *, mode = None, backend = None))]
    fn new(
        py: Python<'_>,
        config: &Config,
        camera: &Camera,
        mode: Option<&str>,
        backend: Option<&str>,
    ) -> PyResult<Self> {
        arrays::check_size(&camera.0)?;
        let settings = &config.settings;
        let execution = options::parsed::<Execution>("mode", mode)?.or(settings.run.mode);
        let execution = execution.unwrap_or(Execution::Lockstep);
        let backend = options::parsed::<Backend>("backend", backend)?.or(settings.run.backend);
        let slam = py.detach(|| {
            let cache = pipeline_cache_folder();
            let model = backend
                .unwrap_or_default()
                .model(&settings.mapping, cache.as_deref());
            let map = model.map_err(IntoPython::into_python)?.map;
            let slam = fgs_slam::Slam::new(&camera.0, &settings.slam(), execution, map);
            slam.map_err(IntoPython::into_python)
        });
        Ok(Self {
            camera: camera.0,
            session: Mutex::new(Some(Session {
                slam: slam?,
                frames: 0,
                last_secs: f64::NEG_INFINITY,
            })),
            result: PyOnceLock::new(),
        })
    }

    /// Tracks a frame and lets the map grow.
    ///
    /// Args:
    ///     color: sRGB, uint8 (H, W, 3), free of lens distortion.
    ///     depth_m: depth along z, registered to the colour image, metres, float32 (H, W); 0 or NaN where nothing was
    ///         measured. float64 is taken too.
    ///     timestamp: when the images were taken, seconds; later than the frame before.
    ///     device_pose: where the recording device (ARKit, say) believes its camera was, ``world_from_camera`` in a
    ///         world of its own: a :class:`Pose` or a matrix of shape (4, 4), with the camera looking along +z, x to
    ///         the right and y down. Its motion from frame to frame helps once it has proved right.
    ///
    /// Returns:
    ///     What became of it. Poses may be corrected later: those of :meth:`finish` are final.
    ///
    /// Raises:
    ///     ShapeError: an array has another shape or type.
    ///     FrameError: the images are not of the camera's size, a depth is negative, or the time is not later.
    ///     SessionError: the session is finished or has failed.
    #[pyo3(signature = (color, depth_m, timestamp, device_pose = None))]
    fn push(
        &self,
        py: Python<'_>,
        color: &Bound<'_, PyAny>,
        depth_m: &Bound<'_, PyAny>,
        timestamp: f64,
        device_pose: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Pose> {
        let device_pose = device_pose.map(pose_of).transpose()?;
        let (color, depth_m) = (arrays::color_image(color)?, arrays::depth_image(depth_m)?);
        let camera = self.camera;
        self.with(py, |session| {
            let index = FrameIndex(session.frames);
            let frame = RgbdFrame::new(index, timestamp, color, depth_m, camera);
            let mut frame = frame.map_err(|error| FrameError::new_err(error.to_string()))?;
            frame.device_pose = device_pose;
            if timestamp <= session.last_secs {
                let last = session.last_secs;
                return Err(FrameError::new_err(format!(
                    "timestamp {timestamp} s is not later than the frame before, at {last} s"
                )));
            }
            session.frames += 1;
            session.last_secs = timestamp;
            let result = session.slam.push(frame);
            result.map(Pose).map_err(IntoPython::into_python)
        })
    }

    /// The map as it is now, with all keyframes so far.
    ///
    /// Raises:
    ///     SessionError: the session is finished or has failed.
    fn snapshot(&self, py: Python<'_>) -> PyResult<Gaussians> {
        Gaussians::from_rust(py, self.map(py)?)
    }

    /// The map as it is now, as NumPy arrays by name: see :meth:`Gaussians.arrays`.
    ///
    /// Raises:
    ///     SessionError: the session is finished or has failed.
    fn gaussians<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        self.snapshot(py)?.arrays(py)
    }

    /// What a camera sees of the map as it is now.
    ///
    /// Args:
    ///     pose: ``world_from_camera``, a :class:`Pose` or a matrix of shape (4, 4).
    ///     camera: the session's own if left out.
    ///
    /// Raises:
    ///     SessionError: the session is finished or has failed.
    #[pyo3(signature = (pose, camera = None))]
    fn render(
        &self,
        py: Python<'_>,
        pose: &Bound<'_, PyAny>,
        camera: Option<&Camera>,
    ) -> PyResult<Render> {
        let view = View {
            camera: camera.map_or(self.camera, |camera| camera.0),
            world_from_camera: pose_of(pose)?,
        };
        Render::of(py, &self.map(py)?, &view)
    }

    /// Ends the session and returns everything; later calls return the same.
    ///
    /// Ctrl-C ends the refinement: KeyboardInterrupt is raised, and the next call returns what there is.
    ///
    /// Args:
    ///     refine: so many more optimisation steps, with all keyframes alike, make a second map.
    ///
    /// Raises:
    ///     SessionError: the session has failed.
    #[pyo3(signature = (refine = 0))]
    fn finish(&self, py: Python<'_>, refine: usize) -> PyResult<Py<SlamResult>> {
        let taken = py.detach(|| self.session.lock().map(|mut session| session.take()).ok());
        if let Some(session) = taken.ok_or_else(broken)? {
            interruptible(py, None, |desk| {
                let output = session.slam.finish_refined(refine, desk.stop);
                Python::attach(|py| {
                    let result = Py::new(py, SlamResult::from_rust(py, output)?)?;
                    // Nobody else has taken the session.
                    let _ = self.result.set(py, result);
                    Ok(())
                })
            })?;
        }
        let result = self.result.get(py).ok_or_else(finished)?;
        Ok(result.clone_ref(py))
    }
}

/// What a session found.
#[pyclass(frozen, get_all, module = "fgs_slam")]
pub struct SlamResult {
    /// The poses of the frames that are not lost, after all corrections.
    trajectory: Py<Trajectory>,
    /// Each frame's verdict, a list of N strings.
    verdicts: Vec<String>,
    /// Which frames became keyframes, from 0.
    keyframes: Vec<usize>,
    /// How often a loop was closed.
    loops: usize,
    /// The map.
    gaussians: Py<Gaussians>,
    /// The map after refinement; None without.
    refined: Option<Py<Gaussians>>,
    /// Why the mapper could not go on, which ended the session early; None if all went well.
    failure: Option<String>,
}

impl SlamResult {
    fn from_rust(py: Python<'_>, output: SlamOutput) -> PyResult<Self> {
        let map = |map| Py::new(py, Gaussians::from_rust(py, map)?);
        let frames = output.frames.iter().filter(|frame| frame.submap == Some(0));
        let poses =
            frames.filter_map(|frame| Some((frame.timestamp_secs?, frame.world_from_camera?)));
        let trajectory = fgs_data::Trajectory::new(poses).map_err(DataError::into_python)?;
        Ok(Self {
            trajectory: Py::new(py, Trajectory(trajectory))?,
            verdicts: output
                .frames
                .iter()
                .map(|frame| frame.status.to_string())
                .collect(),
            keyframes: output
                .keyframes
                .iter()
                .map(|keyframe| keyframe.index.0)
                .collect(),
            loops: output.loops,
            gaussians: map(output.gaussians)?,
            refined: output
                .refined
                .map(|refined| map(refined.gaussians))
                .transpose()?,
            failure: output.failure.map(|failure| failure.to_string()),
        })
    }
}
