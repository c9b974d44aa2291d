//! Puts a folder in the place of another.

use std::ffi::OsString;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Ends the name of a folder that has been set aside while another takes its place.
pub(crate) const REPLACED: &str = ".replaced";

/// Puts the folder `new` at `place`; returns where the one that was there is now. Where the system can
/// exchange two names it is one step.
pub(crate) fn replace(place: &Path, new: &Path) -> io::Result<Option<PathBuf>> {
    if fs::symlink_metadata(place).is_err() {
        fs::rename(new, place)?;
        return Ok(None);
    }
    if exchange(place, new).is_ok() {
        return Ok(Some(new.to_owned()));
    }
    by_moves(place, new).map(Some)
}

#[cfg(any(target_os = "linux", target_vendor = "apple"))]
fn exchange(a: &Path, b: &Path) -> io::Result<()> {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    Ok(renameat_with(CWD, a, CWD, b, RenameFlags::EXCHANGE)?)
}

#[cfg(not(any(target_os = "linux", target_vendor = "apple")))]
fn exchange(_: &Path, _: &Path) -> io::Result<()> {
    Err(io::ErrorKind::Unsupported.into())
}

/// In two steps. Between them there is nothing at `place`; whoever claims it then puts the old folder
/// back.
fn by_moves(place: &Path, new: &Path) -> io::Result<PathBuf> {
    let mut aside: OsString = new.with_extension("").into();
    aside.push(REPLACED);
    let aside = PathBuf::from(aside);
    fs::rename(place, &aside)?;
    match fs::rename(new, place) {
        Ok(()) => Ok(aside),
        Err(error) => {
            fs::rename(&aside, place)?;
            Err(error)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_ways_put_the_new_folder_there_and_keep_the_old() {
        for way in [
            |place: &Path, new: &Path| replace(place, new).map(Option::unwrap),
            by_moves,
        ] {
            let parent = tempfile::tempdir().unwrap();
            let (place, new) = (
                parent.path().join("x"),
                parent.path().join("x.abcdef.unfinished"),
            );
            for folder in [&place, &new] {
                fs::create_dir(folder).unwrap();
            }
            fs::write(place.join("old"), "").unwrap();
            fs::write(new.join("new"), "").unwrap();
            let old = way(&place, &new).unwrap();
            assert!(place.join("new").is_file() && old.join("old").is_file());
            assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 2);
        }
    }
}
