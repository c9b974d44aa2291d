//! Files by their names, in a folder or in a ZIP archive: phones export either.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::{self, BufReader, Read};
use std::path::{Component, Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use fgs_data::DataError;
use zip::ZipArchive;

use crate::fault::{fault, io_fault};

/// What a ZIP archive begins with.
const ZIP_MAGIC: [u8; 4] = *b"PK\x03\x04";

/// What macOS adds to archives of its own.
const MAC_OS_FOLDER: &str = "__MACOSX/";

/// Files by their names, which are relative, with `/` between folders.
pub(crate) struct Tree {
    path: PathBuf,
    place: Place,
}

enum Place {
    Folder,
    Archive {
        archive: Mutex<ZipArchive<BufReader<File>>>,
        /// Each file's place in the archive.
        files: BTreeMap<String, usize>,
    },
}

impl Tree {
    /// A folder or an archive; `None` if it is another file.
    ///
    /// # Errors
    /// If the path leads nowhere or to a damaged archive.
    pub fn open(path: &Path) -> Result<Option<Self>, DataError> {
        if path.is_dir() {
            return Ok(Some(Self {
                path: path.into(),
                place: Place::Folder,
            }));
        }
        let mut file = fgs_files::open_regular(path).map_err(|source| io_fault(path, source))?;
        let mut magic = [0; 4];
        if file.read_exact(&mut magic).is_err() || magic != ZIP_MAGIC {
            return Ok(None);
        }
        let archive = ZipArchive::new(BufReader::new(file))
            .map_err(|error| fault(path, format!("the archive is damaged: {error}")))?;
        let files = files_of(&archive);
        Ok(Some(Self {
            path: path.into(),
            place: Place::Archive {
                archive: Mutex::new(archive),
                files,
            },
        }))
    }

    /// Where a file is, for messages.
    pub fn shown(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// A file's path; `None` in an archive.
    pub fn path_of(&self, name: &str) -> Option<PathBuf> {
        match self.place {
            Place::Folder => Some(self.shown(name)),
            Place::Archive { .. } => None,
        }
    }

    /// Whether there is a file or folder of this name.
    pub fn has(&self, name: &str) -> bool {
        match &self.place {
            Place::Folder => self.path.join(name).exists(),
            Place::Archive { files, .. } => {
                files.contains_key(name) || !names_below(files, name).is_empty()
            }
        }
    }

    /// The names of what is in a folder, in no particular order; none if there is no such folder.
    ///
    /// # Errors
    /// If the folder cannot be read.
    pub fn names_in(&self, folder: &str) -> Result<Vec<String>, DataError> {
        match &self.place {
            Place::Archive { files, .. } => Ok(names_below(files, folder).into_iter().collect()),
            Place::Folder => {
                let path = self.path.join(folder);
                let read = || -> io::Result<Vec<String>> {
                    let names = fs::read_dir(&path)?.map(|entry| Ok(entry?.file_name()));
                    let names: io::Result<Vec<_>> = names.collect();
                    // What is not UTF-8 is none of the names that these formats have.
                    Ok(names?
                        .into_iter()
                        .filter_map(|n| n.into_string().ok())
                        .collect())
                };
                match read() {
                    Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
                    names => names.map_err(|source| io_fault(&path, source)),
                }
            }
        }
    }

    /// A file's bytes.
    ///
    /// # Errors
    /// If there is no such file, or it has more than `max_bytes`, however little its archive claims.
    pub fn read(&self, name: &str, max_bytes: u64) -> Result<Vec<u8>, DataError> {
        let path = self.shown(name);
        let bytes = match &self.place {
            Place::Folder => {
                if !stays_inside(name) {
                    let message = "leads out of the recording's folder".to_owned();
                    return Err(fault(&path, message));
                }
                fgs_files::open_regular(&path).and_then(|file| read_bounded(file, max_bytes))
            }
            Place::Archive { archive, files } => {
                let Some(&index) = files.get(name) else {
                    return Err(fault(&path, "is not in the archive".to_owned()));
                };
                let mut archive = archive.lock().unwrap_or_else(PoisonError::into_inner);
                let file = archive
                    .by_index(index)
                    .map_err(|error| fault(&path, format!("the archive is damaged: {error}")))?;
                read_bounded(file, max_bytes)
            }
        };
        let bytes = bytes.map_err(|source| io_fault(&path, source))?;
        if bytes.len() as u64 > max_bytes {
            return Err(DataError::FileTooLong { path, max_bytes });
        }
        Ok(bytes)
    }
}

/// One byte more than `max_bytes` says that there are more.
fn read_bounded(file: impl Read, max_bytes: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    file.take(max_bytes + 1).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Names in a file may be anything; only those below the recording's folder are opened.
fn stays_inside(name: &str) -> bool {
    let mut components = Path::new(name).components();
    components.all(|part| matches!(part, Component::Normal(_) | Component::CurDir))
}

/// The archive's files, without the one folder that all of them may be in.
fn files_of<R>(archive: &ZipArchive<R>) -> BTreeMap<String, usize>
where
    R: Read + io::Seek,
{
    let names = archive.file_names().enumerate();
    let files: Vec<(usize, String)> = names
        .filter_map(|(index, name)| Some((index, name.ok()?.into_owned())))
        .filter(|(_, name)| !name.ends_with('/') && !name.starts_with(MAC_OS_FOLDER))
        .collect();
    let top = |name: &str| name.split_once('/').map(|(top, _)| top.to_owned());
    let mut tops = files.iter().map(|(_, name)| top(name));
    let first = tops.next().flatten();
    let prefix = first.filter(|first| tops.all(|top| top.as_ref() == Some(first)));
    let prefix = prefix.filter(|_| files.len() > 1).map(|top| top + "/");
    let short = |name: String| match &prefix {
        Some(prefix) => name[prefix.len()..].to_owned(),
        None => name,
    };
    files
        .into_iter()
        .map(|(index, name)| (short(name), index))
        .collect()
}

fn names_below(files: &BTreeMap<String, usize>, folder: &str) -> BTreeSet<String> {
    let prefix = match folder {
        "" => String::new(),
        folder => format!("{folder}/"),
    };
    files
        .range(prefix.clone()..)
        .map_while(|(name, _)| name.strip_prefix(prefix.as_str()))
        .filter_map(|name| name.split('/').next().map(str::to_owned))
        .collect()
}
