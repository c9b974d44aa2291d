//! A folder of results that is replaced as a whole: new results are written beside it and take its
//! place in one step, so that whoever looks sees the old ones or the new ones, also after a crash.
//!
//! Only files that this program wrote are ever removed (see [`Contents`]). A lock keeps a second
//! process out, and what a killed one has left behind is removed by the next that writes there.

use std::cell::RefCell;
use std::collections::HashSet;
use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

use tempfile::{Builder, TempDir};

use crate::SUFFIX;
use crate::contents::{Contents, LIST, UNFINISHED, list_files, write_list};
use crate::lock::Lock;
use crate::switch::{self, REPLACED};

/// Why a folder cannot be written to.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FolderError {
    /// It holds what this program did not write.
    #[error(
        "{} holds {entry:?}, which is not among its results: choose another folder, or move that away",
        folder.display()
    )]
    Foreign {
        /// The folder.
        folder: PathBuf,
        /// One of those entries, relative to it.
        entry: PathBuf,
    },
    /// Another process is writing to it.
    #[error("another fgs is writing to {}", .0.display())]
    Busy(PathBuf),
    /// A whole folder cannot take the place of this one.
    #[error("{} cannot be replaced as a whole: it is {reason}", folder.display())]
    Fixed {
        /// The folder.
        folder: PathBuf,
        /// What it is, and what to do.
        reason: &'static str,
    },
    /// The operating system refuses.
    #[error("{}: {source}", folder.display())]
    Io {
        /// The folder.
        folder: PathBuf,
        /// What it says.
        source: io::Error,
    },
}

/// A folder for results, and the right to write there.
#[derive(Debug)]
pub struct OutputFolder {
    /// As named by the user.
    shown: PathBuf,
    /// Without links and relative parts.
    real: PathBuf,
    _lock: Lock,
}

impl OutputFolder {
    /// Claims a folder that does not exist, is empty, or holds only what this program wrote. Nothing
    /// in it changes before [`StagedFolder::finish`].
    ///
    /// # Errors
    /// [`FolderError`], if it holds anything else, is being written to, or cannot be written.
    pub fn claim(folder: &Path) -> Result<Self, FolderError> {
        let claimed = Self::claim_any(folder)?;
        claimed.check()?;
        Ok(claimed)
    }

    /// Claims the first of `NAME`, `NAME-2`, `NAME-3`, ... in `parent` that does not exist yet.
    ///
    /// # Errors
    /// [`FolderError`] if none can be written.
    pub fn claim_new(parent: &Path, name: &OsStr) -> Result<Self, FolderError> {
        for number in 1_u64.. {
            let mut name = name.to_owned();
            if number > 1 {
                name.push(format!("-{number}"));
            }
            let path = parent.join(name);
            if fs::symlink_metadata(&path).is_ok() {
                continue;
            }
            match Self::claim_any(&path) {
                Err(FolderError::Busy(_)) => {}
                // Another process may have finished it meanwhile.
                Ok(claimed) if claimed.real.exists() => {}
                claimed => return claimed,
            }
        }
        Err(FolderError::Busy(parent.join(name)))
    }

    /// Claims a folder whatever it holds: for [`StagedFolder::carry_over`].
    ///
    /// # Errors
    /// [`FolderError`], as [`claim`](Self::claim).
    pub fn claim_any(folder: &Path) -> Result<Self, FolderError> {
        let io_error = |source| FolderError::Io {
            folder: folder.into(),
            source,
        };
        let real = real_path(folder).map_err(io_error)?;
        let fixed = |reason| FolderError::Fixed {
            folder: folder.into(),
            reason,
        };
        let (Some(parent), Some(name)) = (real.parent(), real.file_name()) else {
            return Err(fixed("the root of the file system"));
        };
        if std::env::current_dir().is_ok_and(|current| current.starts_with(&real)) {
            return Err(fixed(
                "the current folder or one around it (call fgs from elsewhere)",
            ));
        }
        if is_mount_point(&real, parent) {
            return Err(fixed("a mount point (name a folder in it)"));
        }
        let lock = Lock::acquire(parent, &name.to_string_lossy()).map_err(io_error)?;
        let lock = lock.ok_or_else(|| FolderError::Busy(folder.into()))?;
        if lock.is_exclusive {
            remove_left_overs(&real, parent, name).map_err(io_error)?;
        }
        let claimed = Self {
            shown: folder.into(),
            real,
            _lock: lock,
        };
        // That nothing can be written shows before the work.
        claimed.begin().map_err(io_error)?;
        Ok(claimed)
    }

    /// The folder as it was named.
    pub fn path(&self) -> &Path {
        &self.shown
    }

    /// Starts new contents.
    ///
    /// # Errors
    /// If they cannot be written.
    pub fn begin(&self) -> io::Result<StagedFolder<'_>> {
        let (parent, prefix) = crate::place(&self.real)?;
        let mut builder = Builder::new();
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o777));
        let staging = builder.prefix(&prefix).suffix(SUFFIX).tempdir_in(parent)?;
        fs::write(staging.path().join(UNFINISHED), "")?;
        Ok(StagedFolder {
            output: self,
            staging,
            carried: RefCell::default(),
        })
    }

    /// Whether the folder still holds nothing but what this program wrote.
    ///
    /// # Errors
    /// [`FolderError::Foreign`] if not.
    pub fn check(&self) -> Result<(), FolderError> {
        let folder = || self.shown.clone();
        if fs::symlink_metadata(&self.real).is_err() {
            return Ok(());
        }
        let contents = Contents::of(&self.real).map_err(|source| FolderError::Io {
            folder: folder(),
            source,
        })?;
        let others = contents.foreign.iter().chain(&contents.empty);
        match others.filter(|path| **path != self.real).min() {
            None => Ok(()),
            Some(path) => Err(FolderError::Foreign {
                folder: folder(),
                entry: path.strip_prefix(&self.real).unwrap_or(path).into(),
            }),
        }
    }
}

/// New contents of an [`OutputFolder`]. Dropped before they are finished, they are removed again.
#[derive(Debug)]
pub struct StagedFolder<'a> {
    output: &'a OutputFolder,
    staging: TempDir,
    /// What was carried over and is not ours, relative.
    carried: RefCell<HashSet<PathBuf>>,
}

impl StagedFolder<'_> {
    /// Where the new contents are until they are finished: to read what was written.
    pub fn path(&self) -> &Path {
        self.staging.path()
    }

    /// Where a file will be, as the user names it: for messages.
    pub fn shown(&self, name: &str) -> PathBuf {
        self.output.shown.join(name)
    }

    /// Whether there is something in the place that this will take.
    pub fn replaces(&self) -> bool {
        fs::read_dir(&self.output.real).is_ok_and(|mut entries| entries.next().is_some())
    }

    /// Writes a file, replacing one of that name, and returns its size in bytes. If that fails, no part
    /// of it is left.
    ///
    /// # Errors
    /// Whatever `content` returns, or the operating system's refusal.
    pub fn write(
        &self,
        name: &str,
        content: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
    ) -> io::Result<u64> {
        let path = self.staging.path().join(name);
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent)?;
        }
        let write = || {
            let mut writer = BufWriter::new(File::create(&path)?);
            content(&mut writer)?;
            let file = writer.into_inner()?;
            file.sync_all()?;
            Ok(file.metadata()?.len())
        };
        write().inspect_err(|_| {
            let _ = fs::remove_file(&path);
        })
    }

    /// Takes over what the folder holds now, if there is one, but for the entries named in `except`.
    ///
    /// # Errors
    /// If a file can be neither linked nor copied.
    pub fn carry_over(&self, except: &[&str]) -> io::Result<()> {
        let old = &self.output.real;
        if !old.exists() {
            return Ok(());
        }
        let contents = Contents::of(old)?;
        let relative = |path: &PathBuf| path.strip_prefix(old).map(Path::to_owned).ok();
        let foreign: HashSet<PathBuf> = contents.foreign.iter().filter_map(relative).collect();
        let mut names = Vec::new();
        list_files(old, old, &mut names)?;
        for name in names {
            let first = name.iter().next().unwrap_or_default();
            if except.iter().any(|except| first == *except) {
                continue;
            }
            let (from, to) = (old.join(&name), self.staging.path().join(&name));
            if let Some(parent) = to.parent() {
                fs::create_dir_all(parent)?;
            }
            fs::hard_link(&from, &to).or_else(|_| fs::copy(&from, &to).map(drop))?;
            if foreign.contains(&name) {
                self.carried.borrow_mut().insert(name);
            }
        }
        Ok(())
    }

    /// That no file of this name was carried over that this program did not write.
    ///
    /// # Errors
    /// [`FolderError::Foreign`] if one was.
    pub fn may_replace(&self, name: &str) -> Result<(), FolderError> {
        if self.carried.borrow().contains(Path::new(name)) {
            return Err(FolderError::Foreign {
                folder: self.output.shown.clone(),
                entry: name.into(),
            });
        }
        Ok(())
    }

    /// Puts the new contents in place of the old in one step, and removes those.
    ///
    /// # Errors
    /// [`FolderError::Foreign`] if something that this program did not write has appeared there and was
    /// not carried over, or the operating system's refusal. The old contents then stay, and the new
    /// ones are removed.
    pub fn finish(self) -> Result<(), FolderError> {
        let real = self.output.real.clone();
        if self.carried.borrow().is_empty() {
            self.output.check()?;
        }
        self.put_at(&real)
    }

    /// Leaves the old contents alone and puts the new ones into the first free folder beside them.
    ///
    /// # Errors
    /// If there is none, or the operating system refuses.
    pub fn finish_beside(self) -> Result<OutputFolder, FolderError> {
        let shown = &self.output.shown;
        let parent = shown.parent().unwrap_or(Path::new(""));
        let name = self.output.real.file_name().unwrap_or_default();
        let beside = OutputFolder::claim_new(parent, name)?;
        self.put_at(&beside.real)?;
        Ok(beside)
    }

    fn put_at(self, place: &Path) -> Result<(), FolderError> {
        let carried = self.carried.into_inner();
        let staging = self.staging.path();
        let put = || {
            // On a full disk: the results are worth more than knowing that they are ours.
            let _ = write_list(staging, &carried).inspect_err(|_| {
                let _ = fs::remove_file(staging.join(LIST));
            });
            fs::remove_file(staging.join(UNFINISHED))?;
            if let Ok(old) = fs::metadata(place) {
                fs::set_permissions(staging, old.permissions())?;
            }
            sync_folder(staging);
            let old = switch::replace(place, staging)?;
            sync_folder(place.parent().unwrap_or(place));
            Ok(old)
        };
        let old = put().map_err(|source| FolderError::Io {
            folder: self.output.shown.clone(),
            source,
        })?;
        let _ = self.staging.keep();
        if let Some(old) = old {
            for name in &carried {
                // The same file is in the new folder.
                let _ = fs::remove_file(old.join(name));
                for folder in name.ancestors().skip(1) {
                    let _ = fs::remove_dir(old.join(folder));
                }
            }
            remove_replaced(&old);
        }
        Ok(())
    }
}

/// Removes a folder that has been replaced, as far as it is ours.
fn remove_replaced(old: &Path) {
    if let Ok(contents) = Contents::of(old) {
        if contents.foreign.is_empty() {
            contents.remove_ours();
        }
        // One that was empty.
        let _ = fs::remove_dir(old);
    }
}

/// Removes what killed processes left of a folder, and puts back results that one had set aside.
pub(crate) fn remove_left_overs(real: &Path, parent: &Path, name: &OsStr) -> io::Result<()> {
    for entry in fs::read_dir(parent)? {
        let path = entry?.path();
        let is_of = |suffix| crate::is_temporary(&path, name, suffix);
        if is_of(REPLACED) && !real.exists() && path.join(LIST).is_file() {
            fs::rename(&path, real)?;
        } else if (is_of(SUFFIX) || is_of(REPLACED)) && path.is_dir() {
            remove_replaced(&path);
        }
    }
    Ok(())
}

/// The path without links. What does not exist yet is a name in a folder that does, or is made.
fn real_path(folder: &Path) -> io::Result<PathBuf> {
    if fs::symlink_metadata(folder).is_ok() {
        let real = folder.canonicalize()?;
        return match real.is_dir() {
            true => Ok(real),
            false => Err(io::ErrorKind::NotADirectory.into()),
        };
    }
    let name = folder.file_name().ok_or(io::ErrorKind::InvalidFilename)?;
    let parent = match folder.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    };
    fs::create_dir_all(parent)?;
    Ok(parent.canonicalize()?.join(name))
}

/// Names in a folder are on the disk too.
fn sync_folder(folder: &Path) {
    // Not every system lets a folder be opened, and none needs it against a killed process.
    let _ = File::open(folder).and_then(|folder| folder.sync_all());
}

#[cfg(unix)]
fn is_mount_point(folder: &Path, parent: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let device = |path| fs::metadata(path).map(|data: fs::Metadata| data.dev());
    matches!((device(folder), device(parent)), (Ok(a), Ok(b)) if a != b)
}

#[cfg(not(unix))]
fn is_mount_point(_: &Path, _: &Path) -> bool {
    false
}
