//! Files and folders that appear complete or not at all.
//!
//! Both are written under a temporary name (`NAME.xxxxxx.unfinished`) beside their final place and
//! renamed at the end, so neither a full disk nor a crash leaves half a file under its final name.
//! What fails, or is dropped before it is finished, is removed again; what a killed process has left,
//! by the next that writes there.

mod contents;
mod lock;
mod output_folder;
mod reading;
mod switch;

use std::ffi::{OsStr, OsString};
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use tempfile::{Builder, TempDir, TempPath};

use contents::UNFINISHED;
use lock::Lock;
use output_folder::remove_left_overs;

pub use output_folder::{FolderError, OutputFolder, StagedFolder};
pub use reading::{BYTE_ORDER_MARK, check_regular, is_present, is_utf16, open_regular, read_text};

/// Writes a file, replacing an existing one only once the new one is complete and on the disk.
///
/// # Errors
/// Whatever `content` returns, or the operating system's refusal. The old file is then unchanged.
pub fn write_file(
    path: &Path,
    content: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    let (file, unfinished) = begin_file(path)?;
    let mut writer = BufWriter::new(file);
    content(&mut writer)?;
    writer.into_inner()?.sync_all()?;
    Ok(unfinished.persist(path)?)
}

/// Starts a file under a temporary name beside `path`.
fn begin_file(path: &Path) -> io::Result<(File, TempPath)> {
    let (parent, prefix) = place(path)?;
    remove_dead_files(parent, path.file_name().unwrap_or_default());
    let mut builder = Builder::new();
    // Temporary files are private by default; results are to be as readable as any other file.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let (file, unfinished) = builder
        .prefix(&prefix)
        .suffix(SUFFIX)
        .tempfile_in(parent)?
        .into_parts();
    // Tells others that its writer lives. Where there are no locks, nobody looks.
    let _ = file.try_lock();
    Ok((file, unfinished))
}

/// A file that is being written by somebody who knows nothing but its path.
#[derive(Debug)]
pub struct NewFile {
    target: PathBuf,
    unfinished: TempPath,
    /// Locked as long as it is written.
    file: File,
}

impl NewFile {
    /// Starts a file that will stand at `target`, and replace what stands there.
    ///
    /// # Errors
    /// The operating system's refusal.
    pub fn begin(target: &Path) -> io::Result<Self> {
        let (file, unfinished) = begin_file(target)?;
        // There a lock also keeps others from writing.
        if cfg!(windows) {
            let _ = file.unlock();
        }
        Ok(Self {
            target: target.to_owned(),
            unfinished,
            file,
        })
    }

    /// Where it is written until it is finished.
    pub fn path(&self) -> &Path {
        &self.unfinished
    }

    /// Moves the file to its final place once it is on the disk.
    ///
    /// # Errors
    /// The operating system's refusal.
    pub fn finish(self) -> io::Result<()> {
        self.file.sync_all()?;
        Ok(self.unfinished.persist(self.target)?)
    }
}

/// Waits until a folder's names are on the disk: what was renamed before survives a power cut whenever
/// what is renamed after does. Where folders cannot be waited for, as on Windows, it does nothing.
///
/// # Errors
/// The operating system's refusal.
pub fn sync_folder(path: &Path) -> io::Result<()> {
    if cfg!(unix) {
        File::open(path)?.sync_all()?;
    }
    Ok(())
}

/// A new folder that is being filled.
#[derive(Debug)]
pub struct NewFolder {
    target: PathBuf,
    unfinished: TempDir,
    _lock: Lock,
}

impl NewFolder {
    /// Starts a folder that will stand at `target`, whose parent must exist.
    ///
    /// # Errors
    /// [`io::ErrorKind::AlreadyExists`] if there is something at `target`,
    /// [`io::ErrorKind::ResourceBusy`] if another process is making it, or the operating system's
    /// refusal.
    pub fn begin(target: &Path) -> io::Result<Self> {
        refuse_existing(target)?;
        let (parent, prefix) = place(target)?;
        let name = target.file_name().unwrap_or_default();
        let lock =
            Lock::acquire(parent, &name.to_string_lossy())?.ok_or(io::ErrorKind::ResourceBusy)?;
        if lock.is_exclusive {
            remove_left_overs(target, parent, name)?;
        }
        let mut builder = Builder::new();
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o777));
        let unfinished = builder.prefix(&prefix).suffix(SUFFIX).tempdir_in(parent)?;
        fs::write(unfinished.path().join(UNFINISHED), "")?;
        Ok(Self {
            target: target.to_owned(),
            unfinished,
            _lock: lock,
        })
    }

    /// Where its files go until it is finished.
    pub fn path(&self) -> &Path {
        self.unfinished.path()
    }

    /// Writes a new file in it, and makes the folders that its name goes through.
    ///
    /// # Errors
    /// Whatever `content` returns, or the operating system's refusal.
    pub fn write<E: From<io::Error>>(
        &self,
        name: &str,
        content: impl FnOnce(&mut BufWriter<File>) -> Result<(), E>,
    ) -> Result<(), E> {
        let path = self.path().join(name);
        // One by one: should the folder itself be gone, it must not come back without its files.
        let mut folder = self.path().to_owned();
        for part in Path::new(name).parent().into_iter().flatten() {
            folder.push(part);
            if let Err(error) = fs::create_dir(&folder)
                && error.kind() != io::ErrorKind::AlreadyExists
            {
                return Err(error.into());
            }
        }
        let mut file = BufWriter::new(File::create_new(path)?);
        content(&mut file)?;
        Ok(file.flush()?)
    }

    /// Moves the folder to its final place.
    ///
    /// # Errors
    /// [`io::ErrorKind::AlreadyExists`] if something has appeared there in the meantime, or the
    /// operating system's refusal.
    pub fn finish(self) -> io::Result<()> {
        // Renaming would silently replace an empty folder.
        refuse_existing(&self.target)?;
        fs::remove_file(self.unfinished.path().join(UNFINISHED))?;
        fs::rename(self.unfinished.path(), &self.target)?;
        // It is no longer at its temporary path: nothing is left to remove.
        let _ = self.unfinished.keep();
        Ok(())
    }
}

const SUFFIX: &str = ".unfinished";

/// The random part of a temporary name.
const RANDOM_CHARS: usize = 6;

/// Whether a path is a temporary name for `name`.
fn is_temporary(path: &Path, name: &OsStr, suffix: &str) -> bool {
    let (Some(path), Some(name)) = (path.file_name().and_then(OsStr::to_str), name.to_str()) else {
        return false;
    };
    let random = || {
        path.strip_prefix(name)?
            .strip_prefix('.')?
            .strip_suffix(suffix)
    };
    random().is_some_and(|random| {
        random.len() == RANDOM_CHARS && random.chars().all(|c| c.is_ascii_alphanumeric())
    })
}

/// Removes what killed processes have left of the file `name`.
fn remove_dead_files(parent: &Path, name: &OsStr) {
    for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
        let path = entry.path();
        let is_dead = |file: File| {
            file.metadata().is_ok_and(|data| data.is_file()) && file.try_lock().is_ok()
        };
        if is_temporary(&path, name, SUFFIX) && open_regular(&path).is_ok_and(is_dead) {
            let _ = fs::remove_file(path);
        }
    }
}

/// The folder that holds `path`, and the beginning of a temporary name in it.
fn place(path: &Path) -> io::Result<(&Path, OsString)> {
    let mut prefix = path
        .file_name()
        .ok_or(io::ErrorKind::InvalidFilename)?
        .to_owned();
    prefix.push(".");
    let parent = match path.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    };
    Ok((parent, prefix))
}

fn refuse_existing(path: &Path) -> io::Result<()> {
    // A path without a last part, such as `..`, names something that exists.
    if path.file_name().is_none() || fs::symlink_metadata(path).is_ok() {
        return Err(io::ErrorKind::AlreadyExists.into());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<_> = entries
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_appears_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x");
        write_file(&path, |file| file.write_all(b"old")).unwrap();
        let failed = write_file(&path, |file| {
            file.write_all(b"new")?;
            Err(io::ErrorKind::StorageFull.into())
        });
        assert_eq!(failed.unwrap_err().kind(), io::ErrorKind::StorageFull);
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names(folder.path()), ["x"]);
        write_file(&path, |file| file.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(folder.path()), ["x"]);
    }

    #[test]
    fn a_file_that_others_write_appears_when_it_is_finished() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x");
        fs::write(&path, "old").unwrap();
        let dropped = NewFile::begin(&path).unwrap();
        fs::write(dropped.path(), "lost").unwrap();
        drop(dropped);
        let file = NewFile::begin(&path).unwrap();
        fs::write(file.path(), "new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"old");
        file.finish().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(folder.path()), ["x"]);
    }

    /// A file is locked as long as its writer lives.
    #[test]
    fn left_overs_of_the_dead_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let [dead, alive, other] = [
            "x.aB3dEf.unfinished",
            "x.aB3dEg.unfinished",
            "x.mine.unfinished",
        ]
        .map(|name| folder.path().join(name));
        for path in [&dead, &alive, &other] {
            fs::write(path, "").unwrap();
        }
        let writer = File::open(&alive).unwrap();
        writer.lock().unwrap();
        write_file(&folder.path().join("x"), |_| Ok(())).unwrap();
        assert_eq!(
            names(folder.path()),
            ["x", "x.aB3dEg.unfinished", "x.mine.unfinished"]
        );
    }

    #[test]
    fn a_path_that_names_no_file_is_refused() {
        for path in ["..", "/", ""] {
            assert!(write_file(Path::new(path), |_| Ok(())).is_err(), "{path}");
            assert!(NewFolder::begin(Path::new(path)).is_err(), "{path}");
        }
    }

    /// Whatever the process's umask allows, as for any file made without temporary names.
    #[cfg(unix)]
    #[test]
    fn files_and_folders_are_as_readable_as_others() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let mode = |name: &str| {
            let metadata = fs::metadata(folder.path().join(name)).unwrap();
            metadata.permissions().mode()
        };
        fs::write(folder.path().join("plain"), "").unwrap();
        write_file(&folder.path().join("whole"), |_| Ok(())).unwrap();
        assert_eq!(mode("whole"), mode("plain"));
        fs::create_dir(folder.path().join("plain-folder")).unwrap();
        let new = NewFolder::begin(&folder.path().join("whole-folder")).unwrap();
        new.finish().unwrap();
        assert_eq!(mode("whole-folder"), mode("plain-folder"));
    }

    #[test]
    fn a_folder_appears_when_it_is_finished() {
        let parent = tempfile::tempdir().unwrap();
        let target = parent.path().join("room");
        let dropped = NewFolder::begin(&target).unwrap();
        fs::write(dropped.path().join("a"), "1").unwrap();
        drop(dropped);
        assert!(names(parent.path()).is_empty());

        let folder = NewFolder::begin(&target).unwrap();
        let write = |name| folder.write(name, |file| file.write_all(b"1"));
        write("a").unwrap();
        write("b/c").unwrap();
        let again = write("a").unwrap_err();
        assert_eq!(again.kind(), io::ErrorKind::AlreadyExists);
        assert!(!target.exists());
        folder.finish().unwrap();
        assert_eq!(names(parent.path()), ["room"]);
        assert_eq!(names(&target), ["a", "b"]);
        assert_eq!(fs::read(target.join("b/c")).unwrap(), b"1");
    }

    #[test]
    fn an_existing_folder_is_never_replaced() {
        let parent = tempfile::tempdir().unwrap();
        let target = parent.path().join("room");
        let folder = NewFolder::begin(&target).unwrap();
        fs::create_dir(&target).unwrap();
        let late = folder.finish().unwrap_err();
        assert_eq!(late.kind(), io::ErrorKind::AlreadyExists);
        let early = NewFolder::begin(&target).unwrap_err();
        assert_eq!(early.kind(), io::ErrorKind::AlreadyExists);
        // One that was killed left its part.
        let killed = NewFolder::begin(&parent.path().join("hall")).unwrap();
        fs::write(killed.path().join("a"), "1").unwrap();
        let busy = NewFolder::begin(&parent.path().join("hall")).unwrap_err();
        assert_eq!(busy.kind(), io::ErrorKind::ResourceBusy);
        let left = parent.path().join("hall.killed.unfinished");
        fs::create_dir(&left).unwrap();
        fs::write(left.join(UNFINISHED), "").unwrap();
        fs::write(left.join("a"), "1").unwrap();
        drop(killed);
        drop(NewFolder::begin(&parent.path().join("hall")).unwrap());
        assert_eq!(names(parent.path()), ["room"]);
    }
}
