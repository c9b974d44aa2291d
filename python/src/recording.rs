//! Recordings on disk.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use fgs_data::{CameraFile, DataError, Dataset, FrameStream, OpenOptions, PoseOrigin};
use fgs_geom::RgbdFrame;
use numpy::{PyArray2, PyArray3};
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;

use crate::arrays;
use crate::camera::Camera;
use crate::errors::IntoPython;
use crate::trajectory::Trajectory;

/// A recording on disk, of any kind that ``fgs run`` reads: TUM RGB-D, Replica, 7-Scenes, folders ``rgb/`` and
/// ``depth/`` with a ``camera.toml``, and those of phones and robots (docs/recordings.md).
///
/// ``for color, depth_m, timestamp in Recording("my_room"): ...`` gives what :meth:`Slam.push` takes, free of lens
/// distortion. (:func:`run` knows more of a recording: where the lens left no colour, and when the sensors take their
/// images.)
///
/// Args:
///     path: its folder or file.
///     camera: a camera file that overrides the recording's own.
///
/// Raises:
///     DatasetError: it is no recording, or damaged.
#[pyclass(frozen, module = "fgs_slam")]
pub struct Recording(Dataset);

/// Colour, depth and time.
type Frame<'py> = (Bound<'py, PyArray3<u8>>, Bound<'py, PyArray2<f32>>, f64);

impl Recording {
    fn poses_from(&self, origin: PoseOrigin) -> Option<Trajectory> {
        let poses = self
            .0
            .ground_truth()
            .filter(|_| self.0.pose_origin() == origin);
        poses.cloned().map(Trajectory)
    }
}

#[pymethods]
impl Recording {
    #[new]
    #[pyo3(signature = (path, camera = None))]
    fn new(path: PathBuf, camera: Option<PathBuf>) -> PyResult<Self> {
        let camera = camera.map(|path| CameraFile::read(&path)).transpose();
        let options = OpenOptions {
            camera: camera.map_err(IntoPython::into_python)?,
            ..OpenOptions::default()
        };
        let dataset = fgs_recordings::open(&path, &options);
        dataset.map(Self).map_err(IntoPython::into_python)
    }

    /// The camera of every frame.
    #[getter]
    fn camera(&self) -> Camera {
        Camera(*self.0.camera())
    }

    /// Where the camera was, if the recording knows it.
    #[getter]
    fn ground_truth(&self) -> Option<Trajectory> {
        self.poses_from(PoseOrigin::GroundTruth)
    }

    /// Where the recording device believed to be, such as ARKit's poses: an estimate, not the truth.
    #[getter]
    fn device_poses(&self) -> Option<Trajectory> {
        self.poses_from(PoseOrigin::Device)
    }

    /// A frame: colour uint8 (H, W, 3), depth in metres float32 (H, W), time in seconds.
    ///
    /// Raises:
    ///     DatasetError: an image is damaged.
    fn __getitem__<'py>(&self, py: Python<'py>, index: isize) -> PyResult<Frame<'py>> {
        let from_end = self.0.len().checked_sub(index.unsigned_abs());
        let index = if index < 0 {
            from_end
        } else {
            usize::try_from(index).ok()
        };
        let index = index.filter(|index| *index < self.0.len());
        let index = index.ok_or_else(|| PyIndexError::new_err("there is no such frame"))?;
        to_python(py, py.detach(|| self.0.frame(index)))
    }

    fn __iter__(&self) -> Frames {
        Frames(Mutex::new(self.0.frames(0..self.0.len())))
    }

    fn __len__(&self) -> usize {
        self.0.len()
    }

    fn __repr__(&self) -> String {
        format!(
            "<recording of {} frames, {}>",
            self.0.len(),
            self.0.format()
        )
    }
}

/// The frames of a recording, decoded ahead.
#[pyclass(frozen, module = "fgs_slam")]
struct Frames(Mutex<FrameStream>);

#[pymethods]
impl Frames {
    fn __iter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    fn __next__<'py>(&self, py: Python<'py>) -> PyResult<Option<Frame<'py>>> {
        let next = py.detach(|| self.0.lock().unwrap_or_else(PoisonError::into_inner).next());
        next.map(|frame| to_python(py, frame)).transpose()
    }
}

fn to_python(py: Python<'_>, frame: Result<RgbdFrame, DataError>) -> PyResult<Frame<'_>> {
    let frame = frame.map_err(IntoPython::into_python)?;
    Ok((
        arrays::from_color(py, frame.color)?,
        arrays::from_image(py, frame.depth_m)?,
        frame.timestamp_secs,
    ))
}
