//! Which files in a folder this program wrote: those that the list in it names. Only they are ever
//! removed.

use std::collections::HashSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Lists the files of a finished folder, one a line.
pub(crate) const LIST: &str = ".fgs-files";
/// In a folder that is not finished: everything in it is ours.
pub(crate) const UNFINISHED: &str = ".fgs-unfinished";

/// A list is a few names; a larger file is not one of ours.
const MAX_LIST_BYTES: u64 = 64 << 20;

const HEADER: &str =
    "# Written by fgs. The files below are its own: it replaces them when it writes here again.";

/// What a folder holds.
#[derive(Debug, Default)]
pub(crate) struct Contents {
    /// Our files, lists among them.
    ours: Vec<PathBuf>,
    /// Folders that hold some of them, inner ones first.
    folders: Vec<PathBuf>,
    /// All other files.
    pub foreign: Vec<PathBuf>,
    /// Folders with nothing in them.
    pub empty: Vec<PathBuf>,
}

impl Contents {
    /// Looks through a folder and those in it.
    pub fn of(folder: &Path) -> io::Result<Self> {
        let mut contents = Self::default();
        contents.visit(folder, false, &mut HashSet::new())?;
        Ok(contents)
    }

    /// Removes our files, and the folders that are empty then. Lists go last: should the process be
    /// killed meanwhile, the rest is still known to be ours.
    pub fn remove_ours(&self) {
        let is_marker = |path: &&PathBuf| path.ends_with(LIST) || path.ends_with(UNFINISHED);
        for file in self.ours.iter().filter(|path| !is_marker(path)) {
            // What cannot be removed stays, and is found again.
            let _ = fs::remove_file(file);
        }
        for folder in self.empty.iter().chain(&self.folders) {
            let _ = fs::remove_dir(folder);
            let markers = [folder.join(LIST), folder.join(UNFINISHED)];
            let held = fs::read_dir(folder).map_or(0, Iterator::count);
            if held > 0 && held == markers.iter().filter(|marker| marker.is_file()).count() {
                for marker in markers {
                    let _ = fs::remove_file(marker);
                }
                let _ = fs::remove_dir(folder);
            }
        }
    }

    fn visit(
        &mut self,
        folder: &Path,
        is_ours: bool,
        listed: &mut HashSet<PathBuf>,
    ) -> io::Result<()> {
        let all = is_ours || folder.join(UNFINISHED).is_file();
        let list = folder.join(LIST);
        if let Some(text) = read_list(&list) {
            let names = text.lines().filter(|line| !line.starts_with('#'));
            listed.extend(names.map(|name| folder.join(name)));
            listed.insert(list);
        }
        let (before, mut is_empty) = (self.ours.len(), true);
        for entry in fs::read_dir(folder)? {
            let entry = entry?;
            let (path, kind) = (entry.path(), entry.file_type()?);
            is_empty = false;
            if kind.is_dir() {
                self.visit(&path, all, listed)?;
            } else if all || listed.contains(&path) || is_lock(&entry) {
                self.ours.push(path);
            } else {
                self.foreign.push(path);
            }
        }
        if self.ours.len() > before || all {
            self.folders.push(folder.to_owned());
        } else if is_empty {
            self.empty.push(folder.to_owned());
        }
        Ok(())
    }
}

/// A lock that a process left behind when it was killed.
fn is_lock(entry: &fs::DirEntry) -> bool {
    let name = entry.file_name();
    let name = name.to_string_lossy();
    name.starts_with('.')
        && name.ends_with(".lock")
        && entry
            .metadata()
            .is_ok_and(|data| data.is_file() && data.len() == 0)
}

fn read_list(path: &Path) -> Option<String> {
    let is_list =
        fs::symlink_metadata(path).is_ok_and(|data| data.is_file() && data.len() <= MAX_LIST_BYTES);
    let text = is_list.then(|| fs::read_to_string(path).ok()).flatten()?;
    text.starts_with("# Written by fgs").then_some(text)
}

/// Writes the list of all files in a folder but those in `foreign`, which are relative to it.
pub(crate) fn write_list(folder: &Path, foreign: &HashSet<PathBuf>) -> io::Result<()> {
    let mut names = Vec::new();
    list_files(folder, folder, &mut names)?;
    names.retain(|name| !foreign.contains(name));
    names.sort();
    let mut text = format!("{HEADER}\n");
    for name in names {
        let parts = name.iter().map(|part| part.to_string_lossy());
        text += &format!("{}\n", parts.collect::<Vec<_>>().join("/"));
    }
    fs::write(folder.join(LIST), text)
}

/// The files in a folder and those in it, relative to `root`; markers are left out.
pub(crate) fn list_files(root: &Path, folder: &Path, names: &mut Vec<PathBuf>) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let path = entry.path();
        if entry.file_type()?.is_dir() {
            list_files(root, &path, names)?;
        } else if let Ok(name) = path.strip_prefix(root)
            && name != Path::new(LIST)
            && name != Path::new(UNFINISHED)
        {
            names.push(name.to_owned());
        }
    }
    Ok(())
}
