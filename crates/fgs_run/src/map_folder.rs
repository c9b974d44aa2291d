//! A map as a folder, which outlives the run that made it: the state of its session, its keyframes'
//! images, and the settings. A session goes on from it as if it had never ended.
//!
//! `manifest` names the files of one checkpoint, each with its size and checksum; it is replaced by one
//! rename, after everything that it names is on the disk. So the folder holds a whole checkpoint at every
//! moment from the first on, whatever ends the program. Images are written once. A new run in an old
//! folder gives its files another number, and the old map stays until the new one has a checkpoint.
//!
//! State and images are in postcard's format, which keeps every bit of a number; images are deflated.
//! Whatever is read is checked, and takes no more memory than a small multiple of the file, or of the
//! camera's image.

use std::collections::BTreeSet;
use std::fs;
use std::io::{self, BufWriter, Read, Write};
use std::path::{Path, PathBuf};

use fgs_geom::{Camera, KeyframeId, RgbdFrame};
use fgs_slam::SavedSession;
use flate2::read::ZlibDecoder;
use flate2::write::ZlibEncoder;
use flate2::{Compression, Crc, CrcWriter};
use serde::{Deserialize, Serialize};

use crate::error::RunError;
use crate::settings::Settings;

/// What the name of a run's map has in addition to that of the run's folder.
const SUFFIX: &str = ".map";

const MANIFEST: &str = "manifest";

/// First line of the manifest, before the version.
const MAGIC: &str = "fgs map, version ";

/// Raised whenever an older program could not read what a newer one writes.
const VERSION: u32 = 5;

/// A hundred thousand keyframes take less.
const MAX_MANIFEST_BYTES: u64 = 16 << 20;

/// A folder that holds a map.
#[derive(Clone, Debug)]
pub struct MapFolder {
    path: PathBuf,
    manifest: Manifest,
}

/// Which files belong to a checkpoint.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Manifest {
    /// Number of the run, in the names of all its files.
    run: u32,
    /// Number of the checkpoint, in the name of the state.
    checkpoint: u32,
    /// The frame to go on with.
    next_frame: usize,
    settings: Entry,
    state: Entry,
    keyframes: Vec<(KeyframeId, Entry)>,
}

/// What a file must be.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Entry {
    bytes: u64,
    crc32: u32,
}

impl Entry {
    fn of(bytes: &[u8]) -> Self {
        Self {
            bytes: bytes.len() as u64,
            crc32: crc32(bytes),
        }
    }
}

fn crc32(bytes: &[u8]) -> u32 {
    let mut crc = Crc::new();
    crc.update(bytes);
    crc.sum()
}

fn settings_name(run: u32) -> String {
    format!("{run}-settings.toml")
}

fn state_name(run: u32, checkpoint: u32) -> String {
    format!("{run}-state-{checkpoint}.bin")
}

fn keyframe_name(run: u32, id: KeyframeId) -> String {
    format!("{run}-keyframe-{}.bin", id.0)
}

/// The run's number in the name of a file of ours.
fn run_of(name: &str) -> Option<u32> {
    let (run, rest) = name.split_once('-')?;
    let kinds = ["settings.toml", "state-", "keyframe-"];
    let is_ours = kinds.iter().any(|kind| rest.starts_with(kind));
    is_ours.then(|| run.parse().ok())?
}

impl MapFolder {
    /// Opens a map's folder, or the folder of a run that holds one, and reads what belongs to it.
    ///
    /// # Errors
    /// [`RunError::NoMap`] if there is none; [`RunError::MapVersion`] if it is of a newer version;
    /// [`RunError::MapDamaged`] or [`RunError::Read`].
    pub fn open(path: &Path) -> Result<Self, RunError> {
        let of_run = Self::of_run(path);
        let places = [path, &of_run];
        let found = places
            .into_iter()
            .find(|path| path.join(MANIFEST).is_file());
        let folder = found.ok_or_else(|| RunError::NoMap { path: path.into() })?;
        let path = folder.join(MANIFEST);
        let damaged = |what: &str| damaged(&path, what);
        let text = read_at_most(&path, MAX_MANIFEST_BYTES)?;
        let text = String::from_utf8(text).map_err(|_| damaged("it is no text"))?;
        // In every version: the version first, the checksum of all before it last.
        let (content, checksum) =
            (text.trim_end().rsplit_once('\n')).ok_or_else(|| damaged("it is cut off"))?;
        if checksum != format!("{:08x}", crc32(content.as_bytes())) {
            return Err(damaged("its checksum is wrong"));
        }
        let (first, entries) = content.split_once('\n').unwrap_or((content, ""));
        let version = first.strip_prefix(MAGIC).and_then(|text| text.parse().ok());
        match version {
            None => return Err(damaged("it has no version")),
            Some(VERSION) => {}
            Some(version) => {
                return Err(RunError::MapVersion {
                    path: folder.into(),
                    version,
                    known: VERSION,
                });
            }
        }
        let manifest =
            serde_json::from_str(entries).map_err(|error| damaged(&error.to_string()))?;
        Ok(Self {
            path: folder.into(),
            manifest,
        })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The folder for the map of a run: beside its results, which are replaced as a whole when it ends.
    pub fn of_run(run_folder: &Path) -> PathBuf {
        let real = run_folder.canonicalize();
        let mut path = real.unwrap_or_else(|_| run_folder.into()).into_os_string();
        path.push(SUFFIX);
        path.into()
    }

    /// The folder of the run whose map it is.
    pub fn run_folder(&self) -> PathBuf {
        let name = self.path.file_name().unwrap_or_default().to_string_lossy();
        match name.strip_suffix(SUFFIX) {
            Some(run) => self.path.with_file_name(run),
            // The map was renamed.
            None => self.path.with_file_name(format!("{name}-resumed")),
        }
    }

    /// The frame to go on with.
    pub fn next_frame(&self) -> usize {
        self.manifest.next_frame
    }

    /// The settings of its run.
    ///
    /// # Errors
    /// If the file is damaged or cannot be read.
    pub fn settings(&self) -> Result<Settings, RunError> {
        let name = settings_name(self.manifest.run);
        self.read(&name, self.manifest.settings)?;
        Settings::read(&self.path.join(name))
    }

    /// The session.
    ///
    /// # Errors
    /// If the file is damaged or cannot be read.
    pub fn session(&self) -> Result<SavedSession, RunError> {
        let name = state_name(self.manifest.run, self.manifest.checkpoint);
        let bytes = self.read(&name, self.manifest.state)?;
        let saved: SavedSession = self.decoded(&name, &bytes)?;
        let known = self.manifest.keyframes.iter().map(|(id, _)| *id);
        if saved.keyframes().eq(known) && saved.next_frame().0 == self.manifest.next_frame {
            Ok(saved)
        } else {
            Err(damaged(
                &self.path.join(name),
                "it is not what the manifest says",
            ))
        }
    }

    /// A keyframe's images, which are of this camera.
    ///
    /// # Errors
    /// If the file is damaged or cannot be read.
    pub fn keyframe(&self, id: KeyframeId, camera: &Camera) -> Result<RgbdFrame, RunError> {
        let name = keyframe_name(self.manifest.run, id);
        let keyframes = &self.manifest.keyframes;
        let at = keyframes.binary_search_by_key(&id, |(id, _)| *id);
        let damaged = |what: &str| damaged(&self.path.join(&name), what);
        let at = at.map_err(|_| damaged("the manifest lacks it"))?;
        let deflated = self.read(&name, keyframes[at].1)?;
        // Colour, depth and mask take 8 bytes a pixel, the rest a few hundred.
        let most = 8 * (camera.width * camera.height) as u64 + 1024;
        let mut bytes = Vec::new();
        let mut inflated = ZlibDecoder::new(&*deflated).take(most + 1);
        let inflated = inflated.read_to_end(&mut bytes);
        inflated.map_err(|error| damaged(&error.to_string()))?;
        if bytes.len() as u64 > most {
            return Err(damaged("its image is larger than the camera's"));
        }
        let frame: RgbdFrame = self.decoded(&name, &bytes)?;
        if frame.camera != *camera || frame.check().is_err() {
            return Err(damaged("it is no frame of this camera"));
        }
        Ok(frame)
    }

    /// A file's content, if it is what the manifest says.
    fn read(&self, name: &str, entry: Entry) -> Result<Vec<u8>, RunError> {
        let path = self.path.join(name);
        let bytes = read_at_most(&path, entry.bytes)?;
        if Entry::of(&bytes) != entry {
            return Err(damaged(&path, "its checksum is wrong"));
        }
        Ok(bytes)
    }

    fn decoded<'a, T: Deserialize<'a>>(&self, name: &str, bytes: &'a [u8]) -> Result<T, RunError> {
        match postcard::take_from_bytes(bytes) {
            Ok((value, [])) => Ok(value),
            Ok(_) => Err(damaged(&self.path.join(name), "something follows its end")),
            Err(error) => Err(damaged(&self.path.join(name), &error.to_string())),
        }
    }
}

/// Writes a map's folder, checkpoint by checkpoint.
pub struct MapWriter {
    path: PathBuf,
    run: u32,
    checkpoint: u32,
    settings: Entry,
    keyframes: Vec<(KeyframeId, Entry)>,
}

impl MapWriter {
    /// A new map, in a new folder or in that of an older map, which stays until the first checkpoint is
    /// complete.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn begin(path: &Path, settings: &Settings) -> Result<Self, RunError> {
        let made = fs::create_dir_all(path).and_then(|()| names(path));
        let runs = made.map_err(|source| cannot_write(path, source))?;
        let newest = runs.iter().filter_map(|name| run_of(name)).max();
        let run = newest.map_or(0, |run| run.wrapping_add(1));
        let mut writer = Self {
            path: path.into(),
            run,
            checkpoint: 0,
            settings: Entry::of(&[]),
            keyframes: Vec::new(),
        };
        let toml = settings.to_toml()?;
        writer.settings = writer.write_bytes(&settings_name(run), toml.as_bytes())?;
        Ok(writer)
    }

    /// A new map that starts with another's keyframes.
    ///
    /// # Errors
    /// If one cannot be read, is damaged or cannot be written.
    pub fn begin_with(
        path: &Path,
        settings: &Settings,
        known: &MapFolder,
    ) -> Result<Self, RunError> {
        let mut writer = Self::begin(path, settings)?;
        writer.add_all(known)?;
        Ok(writer)
    }

    /// Adds another map's keyframes, numbered on from those that are there.
    ///
    /// # Errors
    /// If one cannot be read, is damaged or cannot be written.
    pub fn add_all(&mut self, known: &MapFolder) -> Result<(), RunError> {
        let newest = self.keyframes.last();
        let first = newest.map_or(0, |(id, _)| id.0.saturating_add(1));
        for (id, entry) in &known.manifest.keyframes {
            let bytes = known.read(&keyframe_name(known.manifest.run, *id), *entry)?;
            let id = KeyframeId(id.0.saturating_add(first));
            let entry = self.write_bytes(&keyframe_name(self.run, id), &bytes)?;
            self.keyframes.push((id, entry));
        }
        Ok(())
    }

    /// Goes on with a map.
    pub fn resume(folder: &MapFolder) -> Self {
        let Manifest {
            run,
            checkpoint,
            settings,
            ref keyframes,
            ..
        } = folder.manifest;
        Self {
            path: folder.path.clone(),
            run,
            checkpoint: checkpoint.wrapping_add(1),
            settings,
            keyframes: keyframes.clone(),
        }
    }

    /// Writes a keyframe's images, which the next checkpoint will name.
    ///
    /// # Errors
    /// If that fails.
    pub fn add_keyframe(&mut self, id: KeyframeId, frame: &RgbdFrame) -> Result<(), RunError> {
        let entry = self.write(&keyframe_name(self.run, id), |file| {
            let deflated = ZlibEncoder::new(file, Compression::fast());
            let deflated = postcard::to_io(frame, deflated).map_err(io::Error::other)?;
            deflated.finish().map(|_| ())
        })?;
        self.keyframes.push((id, entry));
        Ok(())
    }

    /// Completes a checkpoint: from here on the folder holds this session, whose keyframes have all been
    /// added. Then removes what belongs to none.
    ///
    /// # Errors
    /// If that fails; the folder still holds the checkpoint before.
    pub fn complete(&mut self, session: &SavedSession) -> Result<(), RunError> {
        let state = state_name(self.run, self.checkpoint);
        let state = self.write(&state, |file| {
            let written = postcard::to_io(session, file);
            written.map(|_| ()).map_err(io::Error::other)
        })?;
        let manifest = Manifest {
            run: self.run,
            checkpoint: self.checkpoint,
            next_frame: session.next_frame().0,
            settings: self.settings,
            state,
            keyframes: self.keyframes.clone(),
        };
        let entries = serde_json::to_string(&manifest).map_err(io::Error::from);
        let entries = entries.map_err(|source| cannot_write(&self.path.join(MANIFEST), source))?;
        let content = format!("{MAGIC}{VERSION}\n{entries}");
        let text = format!("{content}\n{:08x}\n", crc32(content.as_bytes()));
        self.sync()?;
        self.write_bytes(MANIFEST, text.as_bytes())?;
        self.sync()?;
        self.checkpoint = self.checkpoint.wrapping_add(1);
        self.remove_all_but(&manifest);
        Ok(())
    }

    /// What is there stays there, also in a power cut.
    fn sync(&self) -> Result<(), RunError> {
        fgs_files::sync_folder(&self.path).map_err(|source| cannot_write(&self.path, source))
    }

    fn write_bytes(&self, name: &str, bytes: &[u8]) -> Result<Entry, RunError> {
        self.write(name, |file| file.write_all(bytes))
    }

    fn write(
        &self,
        name: &str,
        content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> Result<Entry, RunError> {
        let path = self.path.join(name);
        let mut crc32 = 0;
        let written = fgs_files::write_file(&path, |file| {
            // Checksums of large pieces are faster.
            let mut file = BufWriter::new(CrcWriter::new(file));
            content(&mut file)?;
            crc32 = file.into_inner()?.crc().sum();
            Ok(())
        });
        let bytes = written.and_then(|()| Ok(fs::metadata(&path)?.len()));
        let bytes = bytes.map_err(|source| cannot_write(&path, source))?;
        Ok(Entry { bytes, crc32 })
    }

    /// Removes files of ours that a manifest does not name. What cannot be removed is in nobody's way.
    fn remove_all_but(&self, manifest: &Manifest) {
        let run = manifest.run;
        let mut named: BTreeSet<String> = (manifest.keyframes.iter())
            .map(|(id, _)| keyframe_name(run, *id))
            .collect();
        named.extend([settings_name(run), state_name(run, manifest.checkpoint)]);
        for name in names(&self.path).unwrap_or_default() {
            let is_manifest = name.starts_with(MANIFEST) && name != MANIFEST;
            if (run_of(&name).is_some() || is_manifest) && !named.contains(&name) {
                let _ = fs::remove_file(self.path.join(name));
            }
        }
    }
}

/// The names in a folder, as far as they are text.
fn names(folder: &Path) -> io::Result<Vec<String>> {
    let entries = fs::read_dir(folder)?;
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    Ok(names.collect())
}

/// A file's bytes; one that is longer is damaged.
fn read_at_most(path: &Path, most: u64) -> Result<Vec<u8>, RunError> {
    let mut bytes = Vec::new();
    let file = fgs_files::open_regular(path);
    let read = file.and_then(|file| file.take(most.saturating_add(1)).read_to_end(&mut bytes));
    match read {
        Ok(_) if bytes.len() as u64 > most => Err(damaged(path, "it is too long")),
        Ok(_) => Ok(bytes),
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            Err(damaged(path, "it is missing"))
        }
        Err(source) => Err(RunError::Read {
            path: path.into(),
            source,
        }),
    }
}

fn damaged(path: &Path, what: &str) -> RunError {
    RunError::MapDamaged {
        path: path.into(),
        what: what.into(),
    }
}

fn cannot_write(path: &Path, source: io::Error) -> RunError {
    RunError::Write {
        path: path.into(),
        source,
    }
}

#[cfg(test)]
mod tests;
