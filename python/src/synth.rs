//! Synthetic recordings.

use std::path::PathBuf;

use fgs_synth::{SensorModel, Sequence, kinect_camera, write_tum};
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::{IntoPython, SettingError};
use crate::interrupt::interruptible;

/// Writes a recording of a furnished room with exact ground truth, in the layout of TUM RGB-D: data to try things on.
///
/// The same arguments always give the same recording. Ctrl-C ends it; then nothing is left behind.
///
/// Args:
///     out: folder to write; must not exist.
///     seed: another seed gives another room and path.
///     frames: how many; 300 go once round the room.
///     size: width and height, pixels; (640, 480) if left out.
///     noise: ``"kinect"`` or ``"none"``.
///     progress: called as ``progress("frames", done, total)``.
///
/// Raises:
///     SettingError: a number is not possible.
///     FileError: the folder exists or cannot be written.
#[pyfunction]
#[pyo3(signature = (out, *, seed = 1, frames = 300, size = (640, 480), noise = "kinect", progress = None))]
pub fn synth(
    py: Python<'_>,
    out: PathBuf,
    seed: u64,
    frames: usize,
    size: (usize, usize),
    noise: &str,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<()> {
    let camera = kinect_camera(size.0, size.1);
    let camera = camera.map_err(|error| SettingError::new_err(format!("size: {error}")))?;
    arrays::check_size(&camera)?;
    let sensor = match noise {
        "kinect" => SensorModel::kinect(),
        "none" => SensorModel::exact(),
        _ => {
            return Err(SettingError::new_err(format!(
                "noise: '{noise}' is none of kinect, none"
            )));
        }
    };
    if !(1..=1_000_000).contains(&frames) {
        return Err(SettingError::new_err(format!(
            "frames: {frames} is not 1 to 1000000"
        )));
    }
    interruptible(py, progress, |desk| {
        let sequence = Sequence::new(seed, frames, camera, sensor);
        let written = write_tum(&sequence, &out, |done| {
            desk.report(("frames", done, frames));
            desk.flow()
        });
        written.map_err(IntoPython::into_python)
    })
}
