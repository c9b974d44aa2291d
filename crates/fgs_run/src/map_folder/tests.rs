use std::collections::BTreeMap;
use std::time::Duration;

use fgs_slam::{Execution, Slam, SlamConfig, model_settings};
use fgs_splat::CpuModel;
use fgs_synth::{SensorModel, Sequence, kinect_camera};
use tempfile::TempDir;

use super::*;
use crate::checkpoints::Checkpoints;

const FRAMES: usize = 14;

struct Recorded {
    sequence: Sequence,
    slam: Slam,
    pushed: usize,
}

/// A session in a small room.
fn recorded() -> Recorded {
    let camera = kinect_camera(160, 120).unwrap();
    let mut config = SlamConfig::default();
    config.mapping.iterations_per_frame = 0.5;
    let model = Box::new(CpuModel::new(model_settings(&config.mapping)));
    let mut slam = Slam::new(&camera, &config, Execution::Lockstep, model).unwrap();
    slam.keep_new_keyframes();
    Recorded {
        sequence: Sequence::new(3, FRAMES, camera, SensorModel::exact()),
        slam,
        pushed: 0,
    }
}

impl Recorded {
    /// Up to a frame; then what is new is added to a folder, and a checkpoint completed.
    fn write(&mut self, until: usize, writer: &mut MapWriter) -> SavedSession {
        for i in self.pushed..until {
            self.slam.push(self.sequence.frame(i)).unwrap();
        }
        self.pushed = until;
        for (id, frame) in self.slam.take_new_keyframes() {
            writer.add_keyframe(id, &frame).unwrap();
        }
        let session = self.slam.save().unwrap();
        writer.complete(&session).unwrap();
        session
    }
}

fn bytes_of(session: &SavedSession) -> Vec<u8> {
    postcard::to_stdvec(session).unwrap()
}

fn sorted_names(folder: &Path) -> Vec<String> {
    let mut names = names(folder).unwrap();
    names.sort();
    names
}

/// A map after all frames.
fn map() -> (TempDir, SavedSession) {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = MapWriter::begin(folder.path(), &Settings::default()).unwrap();
    let session = recorded().write(FRAMES, &mut writer);
    (folder, session)
}

/// Everything in a folder.
fn read_all(folder: &Path) -> Result<(SavedSession, Vec<RgbdFrame>, Settings), RunError> {
    let map = MapFolder::open(folder)?;
    let session = map.session()?;
    let frames = session
        .keyframes()
        .map(|id| map.keyframe(id, session.camera()));
    let frames = frames.collect::<Result<_, _>>()?;
    Ok((session, frames, map.settings()?))
}

#[test]
fn what_is_written_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.map");
    let mut recorded = recorded();
    let mut writer = MapWriter::begin(&path, &Settings::default()).unwrap();
    recorded.write(3, &mut writer);
    let written = recorded.write(FRAMES, &mut writer);
    assert!(written.keyframes().len() >= 2);
    // Given the map's folder or the run's.
    for given in [&path, &folder.path().join("run")] {
        let (session, frames, settings) = read_all(given).unwrap();
        assert!(bytes_of(&session) == bytes_of(&written));
        assert_eq!(settings, Settings::default());
        for frame in frames {
            // Depth and colour of a sensor without flaws are a keyframe's as they are.
            let shown = recorded.sequence.frame(frame.index.0);
            assert!(frame.color == shown.color && frame.depth_m == shown.depth_m);
        }
    }
    assert_eq!(MapFolder::open(&path).unwrap().next_frame(), FRAMES);
}

#[test]
fn what_no_checkpoint_names_goes_and_all_else_stays() {
    let (folder, _) = map();
    let path = folder.path();
    let first = sorted_names(path);
    fs::write(path.join("notes.txt"), "mine").unwrap();
    fs::write(path.join("0-keyframe-77.bin"), "of a run that was killed").unwrap();
    fs::write(path.join("manifest.abcdef.unfinished"), "").unwrap();
    let old: BTreeMap<String, Vec<u8>> = (first.iter())
        .map(|name| (name.clone(), fs::read(path.join(name)).unwrap()))
        .collect();

    // Another run: until it has a checkpoint, the old map is whole.
    let mut recorded = recorded();
    let mut writer = MapWriter::begin(path, &Settings::default()).unwrap();
    for i in 0..5 {
        recorded.slam.push(recorded.sequence.frame(i)).unwrap();
    }
    for (id, frame) in recorded.slam.take_new_keyframes() {
        writer.add_keyframe(id, &frame).unwrap();
    }
    assert!(
        old.iter()
            .all(|(name, bytes)| fs::read(path.join(name)).unwrap() == *bytes)
    );
    assert_eq!(MapFolder::open(path).unwrap().next_frame(), FRAMES);
    let session = recorded.slam.save().unwrap();
    writer.complete(&session).unwrap();
    assert_eq!(MapFolder::open(path).unwrap().next_frame(), 5);
    assert_eq!(
        sorted_names(path),
        [
            "1-keyframe-0.bin",
            "1-settings.toml",
            "1-state-0.bin",
            "manifest",
            "notes.txt"
        ]
    );
}

#[test]
fn a_newer_version_and_a_folder_without_a_map_are_refused() {
    let (folder, _) = map();
    let path = folder.path().join(MANIFEST);
    let text = fs::read_to_string(&path).unwrap();
    let (_, entries) = text.split_once('\n').unwrap();
    let (entries, _) = entries.split_once('\n').unwrap();
    let content = format!("{MAGIC}{}\nsomething else\n{entries}", VERSION + 1);
    let newer = format!("{content}\n{:08x}\n", crc32(content.as_bytes()));
    fs::write(&path, newer).unwrap();
    let error = MapFolder::open(folder.path()).unwrap_err();
    let message = format!(
        "is of version {}; this program reads version {VERSION}",
        VERSION + 1
    );
    assert!(error.to_string().ends_with(&message));
    fs::remove_file(path).unwrap();
    let error = MapFolder::open(folder.path()).unwrap_err();
    assert!(matches!(error, RunError::NoMap { .. }) && error.is_usage());
}

/// Every file, at many places: a flipped bit, a cut, a byte too many, a file that is gone.
#[test]
fn damage_is_found_and_the_file_is_named() {
    let (folder, _) = map();
    let path = folder.path();
    for name in sorted_names(path) {
        let file = path.join(&name);
        let whole = fs::read(&file).unwrap();
        let refused = |bytes: Option<&[u8]>, what: &str| {
            match bytes {
                Some(bytes) => fs::write(&file, bytes).unwrap(),
                None => fs::remove_file(&file).unwrap(),
            }
            let refused = read_all(path).map(|_| ());
            let message = refused.unwrap_err().to_string();
            let gone = name == MANIFEST && bytes.is_none();
            assert!(gone || message.contains(&name), "{what}: {message}");
        };
        for part in 0..24 {
            let at = (part * 7919 + part * whole.len() / 24) % whole.len();
            let mut flipped = whole.clone();
            flipped[at] ^= 1 << (part % 8);
            refused(Some(&flipped), &format!("{name}, byte {at}"));
        }
        for len in [0, 1, whole.len() / 2, whole.len() - 2] {
            refused(Some(&whole[..len]), &format!("{name} cut to {len}"));
        }
        refused(Some(&[&whole[..], b"x"].concat()), "a byte more");
        refused(None, "no file");
        fs::write(&file, &whole).unwrap();
    }
    read_all(path).unwrap();
}

/// A small file that inflates to more than a camera's image is not inflated.
#[test]
fn an_image_larger_than_the_cameras_is_refused() {
    let (folder, session) = map();
    let mut writer = MapWriter::resume(&MapFolder::open(folder.path()).unwrap());
    let mut bomb = ZlibEncoder::new(Vec::new(), Compression::best());
    bomb.write_all(&vec![0; 50 << 20]).unwrap();
    let bomb = bomb.finish().unwrap();
    let (id, entry) = &mut writer.keyframes[0];
    let name = keyframe_name(writer.run, *id);
    fs::write(folder.path().join(&name), &bomb).unwrap();
    *entry = Entry::of(&bomb);
    writer.complete(&session).unwrap();
    let message = read_all(folder.path()).map(|_| ()).unwrap_err().to_string();
    assert!(
        message.ends_with("its image is larger than the camera's"),
        "{message}"
    );
}

#[test]
fn a_map_that_cannot_be_written_ends_the_checkpoints_and_not_the_session() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.map");
    let mut recorded = recorded();
    let writer = MapWriter::begin(&path, &Settings::default()).unwrap();
    let mut checkpoints = Checkpoints::begin(Duration::ZERO, writer, &mut recorded.slam);
    for i in 0..FRAMES {
        recorded.slam.push(recorded.sequence.frame(i)).unwrap();
        checkpoints.after_frame(&mut recorded.slam);
        if i == 2 {
            assert_eq!(MapFolder::open(&path).unwrap().next_frame(), 3);
            fs::remove_dir_all(&path).unwrap();
        }
    }
    let message = checkpoints
        .finish(&mut recorded.slam)
        .unwrap_err()
        .to_string();
    assert!(message.contains("0-state-3.bin"), "{message}");
    assert!(!path.exists() && recorded.slam.take_new_keyframes().is_empty());
    assert_eq!(recorded.slam.finish().frames.len(), FRAMES);
}
