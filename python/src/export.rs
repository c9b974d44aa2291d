//! A finished run in the formats of other programs.

use std::path::PathBuf;

use fgs_run::{ExportFormat, ExportOptions};
use pyo3::prelude::*;

use crate::errors::{IntoPython, SettingError};
use crate::interrupt::interruptible;
use crate::run::Run;

/// Takes a finished run to other programs, as ``fgs export`` does. Ctrl-C ends it; then nothing is written.
///
/// Args:
///     run: a :class:`Run` or the folder of one.
///     to: ``"ply"``, ``"compressed-ply"``, ``"splat"``, ``"spz"`` or ``"glb"`` (gaussians), ``"points"``,
///         ``"mesh-ply"``, ``"mesh-obj"`` or ``"mesh-glb"`` (the measured surface), ``"tum"`` or ``"kitti"`` (the
///         trajectory), ``"colmap"`` or ``"nerfstudio"`` (photographs with poses).
///     out: file or folder to write; in the run's folder ``export`` if left out.
///     dataset: folder of the recording, for photographs; where it was during the run if left out.
///     raw_axes: keep the first camera's axes in place of level ones.
///     voxel_m: side of a voxel, for meshes, 0.001 to 1 m.
///     progress: called as ``progress("export", done, total)``.
///
/// Returns:
///     The file or folder.
///
/// Raises:
///     SettingError: there is no such format, or the voxels are too small.
///     FileError: the run cannot be read or the export not be written.
///     DatasetError: the recording cannot be read.
///     RunError: there is nothing to export.
#[pyfunction]
#[pyo3(signature = (
    run, to, *, out = None, dataset = None, raw_axes = false, voxel_m = 0.01, progress = None
))]
#[allow(clippy::too_many_arguments, reason = "keywords in Python")]
pub fn export(
    py: Python<'_>,
    run: &Bound<'_, PyAny>,
    to: &str,
    out: Option<PathBuf>,
    dataset: Option<PathBuf>,
    raw_axes: bool,
    voxel_m: f64,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<PathBuf> {
    let run = match run.cast::<Run>() {
        Ok(run) => run.get().path.clone(),
        Err(_) => run.extract()?,
    };
    let to: ExportFormat = to
        .parse()
        .map_err(|error| SettingError::new_err(format!("to: {error}")))?;
    let options = ExportOptions {
        run,
        to,
        out,
        dataset,
        raw_axes,
        voxel_m,
    };
    let exported = interruptible(py, progress, |desk| {
        let exported = options.export(&mut |done, total| {
            desk.report(("export", done, total));
            desk.flow()
        });
        exported.map_err(IntoPython::into_python)
    })?;
    Ok(exported.path)
}
