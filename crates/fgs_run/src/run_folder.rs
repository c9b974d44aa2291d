//! The folder of a run and the names of its files, each of which appears complete or not at all.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

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
/// The page for people.
pub const REPORT: &str = "report.html";
/// Renders beside the input.
pub const PICTURES: &str = "pictures";

/// The files that a run leaves.
const RESULTS: [&str; 8] = [
    METRICS,
    TRAJECTORY,
    REFERENCE,
    FRAMES,
    MAP,
    REFINED_MAP,
    CONFIG,
    REPORT,
];

/// A run's folder.
#[derive(Clone, Debug)]
pub struct RunFolder {
    path: PathBuf,
}

impl RunFolder {
    /// Makes the folder, or takes an existing one, and tries that files can be written there.
    ///
    /// # Errors
    /// If not.
    pub fn create(path: &Path) -> Result<Self, RunError> {
        let folder = Self { path: path.into() };
        let probe = folder.join("probe.unfinished");
        fs::create_dir_all(path)
            .and_then(|()| File::create(&probe))
            .and_then(|mut file| file.write_all(b"writable"))
            .and_then(|()| fs::remove_file(&probe))
            .map_err(|source| RunError::OutputFolder {
                path: path.into(),
                source,
            })?;
        Ok(folder)
    }

    /// The folder of a finished run.
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
        RESULTS.into_iter().any(same)
    }

    /// Makes the first of `NAME`, `NAME-2`, `NAME-3`, ... in `parent` that does not exist yet.
    ///
    /// # Errors
    /// If no folder can be made or written to.
    pub fn create_new(parent: &Path, name: &str) -> Result<Self, RunError> {
        let mut path = parent.join(name);
        let mut number = 2_u32;
        while path.exists() {
            path = parent.join(format!("{name}-{number}"));
            number += 1;
        }
        Self::create(&path)
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A file in it.
    pub fn join(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Writes a file, which appears complete or not at all, replacing one of that name.
    ///
    /// # Errors
    /// If writing fails, for example because the disk is full.
    pub fn write(
        &self,
        name: &str,
        content: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
    ) -> Result<(), RunError> {
        let path = self.join(name);
        fgs_files::write_file(&path, content).map_err(|source| RunError::Write { path, source })
    }

    /// Removes the results of an earlier run, so that the folder never mixes two runs, not even if
    /// some of the new results cannot be written.
    pub(crate) fn clear_results(&self) {
        for name in RESULTS {
            // What is not there, or cannot be removed, shows when the new file is written.
            let _ = fs::remove_file(self.join(name));
        }
    }

    /// Makes `pictures/` and removes an earlier run's pictures from it.
    ///
    /// # Errors
    /// If the folder cannot be made or cleared.
    pub(crate) fn start_pictures(&self) -> Result<(), RunError> {
        let pictures = self.join(PICTURES);
        let clear = || -> io::Result<()> {
            fs::create_dir_all(&pictures)?;
            for entry in fs::read_dir(&pictures)? {
                let path = entry?.path();
                if path.extension().is_some_and(|ending| ending == "png") {
                    fs::remove_file(&path)?;
                }
            }
            Ok(())
        };
        clear().map_err(|source| RunError::Write {
            path: pictures.clone(),
            source,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(path: &Path) -> Vec<String> {
        let entries = fs::read_dir(path).unwrap();
        let mut names: Vec<_> = entries
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn new_folders_are_counted() {
        let parent = tempfile::tempdir().unwrap();
        for _ in 0..3 {
            RunFolder::create_new(parent.path(), "desk").unwrap();
        }
        assert_eq!(names(parent.path()), ["desk", "desk-2", "desk-3"]);
    }
}
