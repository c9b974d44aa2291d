//! A lock on a name, beside which it lies as an empty hidden file. The operating system releases it
//! when the process ends, however it ends.

use std::fs::{File, OpenOptions, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

/// Held while it lives; then the file is removed.
#[derive(Debug)]
pub(crate) struct Lock {
    file: File,
    path: PathBuf,
    /// `false` on file systems that have no locks.
    pub is_exclusive: bool,
}

impl Lock {
    /// The lock on a name in a folder; `None` if another process holds it.
    pub fn acquire(folder: &Path, name: &str) -> io::Result<Option<Self>> {
        let path = folder.join(format!(".{name}.lock"));
        loop {
            let mut options = OpenOptions::new();
            let file = options.create(true).append(true).open(&path)?;
            let is_exclusive = match file.try_lock() {
                Ok(()) => true,
                Err(TryLockError::WouldBlock) => return Ok(None),
                Err(TryLockError::Error(e)) if e.kind() == io::ErrorKind::Unsupported => false,
                Err(TryLockError::Error(error)) => return Err(error),
            };
            // The holder before may have removed the file after it was opened here.
            if is_file_at(&file, &path) {
                return Ok(Some(Self {
                    file,
                    path,
                    is_exclusive,
                }));
            }
        }
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        if cfg!(unix) && self.is_exclusive && is_file_at(&self.file, &self.path) {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Whether an open file is the one that a path leads to.
#[cfg(unix)]
fn is_file_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let id = |metadata: std::fs::Metadata| (metadata.dev(), metadata.ino());
    let ids = (file.metadata().map(id), std::fs::metadata(path).map(id));
    matches!(ids, (Ok(open), Ok(named)) if open == named)
}

/// Elsewhere the file stays where it is, so that it always is.
#[cfg(not(unix))]
fn is_file_at(_: &File, _: &Path) -> bool {
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_holder_at_a_time_and_nothing_left() {
        let folder = tempfile::tempdir().unwrap();
        let held = Lock::acquire(folder.path(), "x").unwrap().unwrap();
        assert!(Lock::acquire(folder.path(), "x").unwrap().is_none());
        assert!(Lock::acquire(folder.path(), "y").unwrap().is_some());
        drop(held);
        if cfg!(unix) {
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        }
        assert!(Lock::acquire(folder.path(), "x").unwrap().is_some());
    }

    /// Whoever opened the file before its holder removed it has no lock on the name.
    #[cfg(unix)]
    #[test]
    fn a_removed_file_locks_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(".x.lock");
        let stale = File::create(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        stale.lock().unwrap();
        assert!(!is_file_at(&stale, &path));
        assert!(Lock::acquire(folder.path(), "x").unwrap().is_some());
    }
}
