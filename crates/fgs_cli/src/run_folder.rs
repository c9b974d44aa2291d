//! The folder of a run: names of its files, and writing them so that nothing half-written ever
//! stands under its final name.

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::Context;

/// The metrics, written last: a folder that has them is whole.
pub const METRICS: &str = "metrics.json";
/// The estimated poses.
pub const TRAJECTORY: &str = "trajectory.txt";
/// What became of each frame.
pub const FRAMES: &str = "frames.csv";
/// The map.
pub const MAP: &str = "map.ply";
/// All settings; reruns the run.
pub const CONFIG: &str = "config.effective.toml";
/// Renders beside the input.
pub const PICTURES: &str = "pictures";

/// Ending of a file that is being written.
const UNFINISHED: &str = ".unfinished";

/// A run's folder.
#[derive(Clone, Debug)]
pub struct RunFolder {
    path: PathBuf,
}

impl RunFolder {
    /// Makes the folder, or takes one that exists, and tries that files can be written there.
    ///
    /// # Errors
    /// If not.
    pub fn create(path: &Path) -> anyhow::Result<Self> {
        let folder = Self { path: path.into() };
        let context = || format!("cannot write to the output folder {}", path.display());
        fs::create_dir_all(path).with_context(context)?;
        let probe = folder.join(&format!("probe{UNFINISHED}"));
        File::create(&probe)
            .and_then(|mut file| file.write_all(b"writable"))
            .and_then(|()| fs::remove_file(&probe))
            .with_context(context)?;
        Ok(folder)
    }

    /// Makes the first of `NAME`, `NAME-2`, `NAME-3`, ... in `parent` that is not there yet.
    ///
    /// # Errors
    /// If no folder can be made or written to.
    pub fn create_new(parent: &Path, name: &str) -> anyhow::Result<Self> {
        let names = (2..).map(|n| format!("{name}-{n}"));
        for name in std::iter::once(name.to_owned()).chain(names) {
            let path = parent.join(name);
            if !path.exists() {
                return Self::create(&path);
            }
        }
        anyhow::bail!("no free name for an output folder in {}", parent.display())
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A file in it.
    pub fn join(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Writes a file, which appears whole or not at all; replaces one of that name.
    ///
    /// # Errors
    /// If writing fails, for example because the disk is full. Nothing is left then.
    pub fn write(
        &self,
        name: &str,
        content: impl FnOnce(&mut BufWriter<File>) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        write_whole(&self.join(name), content)
    }

    /// Empties `pictures/` of an earlier run's pictures and makes it.
    ///
    /// # Errors
    /// If the folder cannot be made.
    pub fn start_pictures(&self) -> anyhow::Result<()> {
        let pictures = self.join(PICTURES);
        let context = || format!("cannot write to {}", pictures.display());
        fs::create_dir_all(&pictures).with_context(context)?;
        for entry in fs::read_dir(&pictures).with_context(context)? {
            let path = entry.with_context(context)?.path();
            if path.extension().is_some_and(|ending| ending == "png") {
                fs::remove_file(&path).with_context(context)?;
            }
        }
        Ok(())
    }
}

/// Writes a file under another name and renames it when it is whole and on the disk.
///
/// # Errors
/// If writing fails. Nothing is left then.
pub fn write_whole(
    path: &Path,
    content: impl FnOnce(&mut BufWriter<File>) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let mut unfinished = path.as_os_str().to_owned();
    unfinished.push(UNFINISHED);
    let unfinished = PathBuf::from(unfinished);
    let write = || -> anyhow::Result<()> {
        let mut file = BufWriter::new(File::create(&unfinished)?);
        content(&mut file)?;
        file.into_inner()?.sync_all()?;
        Ok(fs::rename(&unfinished, path)?)
    };
    write()
        .inspect_err(|_| {
            // Best effort: the first error is the one to report.
            let _ = fs::remove_file(&unfinished);
        })
        .with_context(|| format!("cannot write {}", path.display()))
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
    fn a_file_appears_whole_or_not_at_all() {
        let parent = tempfile::tempdir().unwrap();
        let folder = RunFolder::create(&parent.path().join("a/b")).unwrap();
        assert!(names(folder.path()).is_empty());
        folder
            .write("x", |file| Ok(file.write_all(b"old")?))
            .unwrap();
        let failed = folder.write("x", |file| {
            file.write_all(b"new")?;
            anyhow::bail!("disk full")
        });
        let message = format!("{:#}", failed.unwrap_err());
        assert!(message.ends_with("x: disk full"), "{message}");
        assert_eq!(fs::read(folder.join("x")).unwrap(), b"old");
        assert_eq!(names(folder.path()), ["x"]);
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
