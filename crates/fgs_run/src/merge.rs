//! Two maps of one place become one.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use fgs_files::OutputFolder;
use fgs_geom::Se3;
use fgs_slam::{Execution, SavedSession, Slam};

use crate::backend::Backend;
use crate::error::RunError;
use crate::map_folder::{MapFolder, MapWriter};
use crate::run_folder::MAP;
use crate::run_result::write_map;
use crate::up::{self, up_of};

/// What to merge, and where to.
#[derive(Clone, Debug)]
pub struct MergeOptions {
    /// Folders of maps, or of the runs that left them. Axes and settings are the first's.
    pub maps: [PathBuf; 2],
    /// Folder for `map.ply`. Beside it, with `.map` added to its name, comes the folder that runs go on with.
    pub out: PathBuf,
    /// Where the map is optimised.
    pub backend: Backend,
    /// Optimisation steps with the keyframes of both, which give `map.ply`.
    pub refine: usize,
    /// Folder in which a graphics device's compiled shaders are kept; none.
    pub pipeline_cache: Option<PathBuf>,
}

/// What two maps became.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Merged {
    /// How often a place of the one was found in the other.
    pub loops: usize,
    /// Keyframes of both.
    pub keyframes: usize,
    /// Gaussians of both.
    pub num_gaussians: usize,
    /// Size of `map.ply`.
    pub map_bytes: u64,
}

/// Merges two maps: places that both show are found as loops are. `stop` ends the optimisation early.
///
/// # Errors
/// If a map cannot be read, the two are of different cameras or meet nowhere
/// ([`RunError::MapsDoNotMeet`]), or the results cannot be written. The two maps stay as they are.
pub fn merge(options: &MergeOptions, stop: &AtomicBool) -> Result<Merged, RunError> {
    let [first, second] = &options.maps;
    let folders = [MapFolder::open(first)?, MapFolder::open(second)?];
    let out = MapFolder::of_run(&options.out);
    if folders.iter().any(|folder| is_same(folder.path(), &out)) {
        return Err(RunError::MergesInto { path: out });
    }
    let settings = folders[0].settings()?.of_another_run();
    let cache = options.pipeline_cache.as_deref();
    let model = options.backend.model(&settings.mapping, cache)?;
    let results = OutputFolder::claim(&options.out)?;
    let sessions = [folders[0].session()?, folders[1].session()?];
    let cameras = [0, 1].map(|map: usize| *SavedSession::camera(&sessions[map]));
    let merged = Slam::merged(
        &settings.slam(),
        Execution::Lockstep,
        model.map,
        sessions,
        |map, id| folders[map].keyframe(id, &cameras[map]),
    )?;
    let mut slam = merged.ok_or_else(|| RunError::MapsDoNotMeet {
        first: first.clone(),
        second: second.clone(),
    })?;
    let mut writer = MapWriter::begin(&out, &settings)?;
    for folder in &folders {
        writer.add_all(folder)?;
    }
    writer.complete(&slam.save()?)?;
    let output = slam.finish_refined(options.refine, stop);
    if let Some(failure) = output.failure {
        return Err(failure.into());
    }
    let map = output
        .refined
        .map_or(output.gaussians, |refined| refined.gaussians);
    let staged = results.begin().map_err(|source| RunError::OutputFolder {
        path: results.path().into(),
        source,
    })?;
    let map_bytes = write_map(&map, &staged, MAP)?;
    let poses: Vec<Se3> = (output.keyframes.iter())
        .map(|keyframe| keyframe.world_from_camera)
        .collect();
    // The first run's, whose axes these are, if it has found one.
    up::save(&up_of(Some(first), &map, &poses), &staged)?;
    staged.finish()?;
    Ok(Merged {
        loops: output.loops,
        keyframes: output.keyframes.len(),
        num_gaussians: map.len(),
        map_bytes,
    })
}

fn is_same(a: &Path, b: &Path) -> bool {
    a.canonicalize()
        .is_ok_and(|a| b.canonicalize().is_ok_and(|b| a == b))
}
