//! The folder of a run and the names of its files. It is written as a whole: see
//! [`fgs_files::OutputFolder`].

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

use fgs_files::StagedFolder;

use crate::error::RunError;

/// The metrics.
pub const METRICS: &str = "metrics.json";
/// The estimated poses.
pub const TRAJECTORY: &str = "trajectory.txt";
/// What became of each frame.
pub const FRAMES: &str = "frames.csv";
/// The map when the recording had ended.
pub const MAP: &str = "map.ply";
/// The map after refinement, if there was any.
pub const REFINED_MAP: &str = "refined.ply";
/// All settings; repeats the run.
pub const CONFIG: &str = "config.effective.toml";
/// The recording's ground truth in the run's coordinates, if there is any.
pub const REFERENCE: &str = "reference.txt";
/// Which way is up in the map's coordinates.
pub const UP: &str = "up.txt";
/// The page for people.
pub const REPORT: &str = "report.html";
/// Renders beside the input.
pub const PICTURES: &str = "pictures";

/// The files that a run leaves.
const RESULTS: [&str; 9] = [
    METRICS,
    TRAJECTORY,
    REFERENCE,
    FRAMES,
    MAP,
    REFINED_MAP,
    CONFIG,
    UP,
    REPORT,
];

/// The name of a result that a sub-map has beside the largest one's: `map.ply` becomes `map_1.ply`.
pub(crate) fn of_submap(name: &str, number: usize) -> String {
    let (stem, ending) = name.rsplit_once('.').unwrap_or((name, ""));
    format!("{stem}_{number}.{ending}")
}

/// The folder of a finished run.
#[derive(Clone, Debug)]
pub struct RunFolder {
    path: PathBuf,
}

impl RunFolder {
    /// Opens the folder of a finished run.
    ///
    /// # Errors
    /// [`RunError::NotARun`] if it is not one.
    pub fn open(path: &Path) -> Result<Self, RunError> {
        if !path.join(CONFIG).is_file() {
            return Err(RunError::NotARun { path: path.into() });
        }
        Ok(Self { path: path.into() })
    }

    /// Whether a path is that of a file that the run has left here.
    pub fn holds_result(&self, path: &Path) -> bool {
        let same = |name: &str| {
            let result = self.join(name).canonicalize();
            result.is_ok_and(|result| path.canonicalize().is_ok_and(|path| path == result))
        };
        let of_others = |number| [TRAJECTORY, MAP, REFINED_MAP].map(|name| of_submap(name, number));
        let others = (1..).map(of_others);
        let mut others = others.take_while(|[poses, ..]| self.join(poses).is_file());
        RESULTS.into_iter().any(same) || others.any(|names| names.iter().any(|name| same(name)))
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A file in it.
    pub fn join(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }
}

/// Writes a result; returns its size in bytes.
pub(crate) fn write(
    results: &StagedFolder<'_>,
    name: &str,
    content: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<u64, RunError> {
    let path = results.shown(name);
    results
        .write(name, content)
        .map_err(|source| RunError::Write { path, source })
}
