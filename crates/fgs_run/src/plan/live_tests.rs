//! Runs with a live camera, which is a synthetic one.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::sleep;
use std::time::Duration;

use fgs_data::{CameraFile, DataError, FrameImages, LiveImages};
use fgs_slam::FrameStatus;
use fgs_synth::{SensorModel, Sequence, kinect_camera};

use super::*;
use crate::run_folder::{MAP, REPORT, RunFolder, TRAJECTORY};

/// A camera in a room that takes its next frame when the one before has been tracked, so that none is
/// dropped on a slow machine, and ends after so many.
struct Room {
    sequence: Sequence,
    file: CameraFile,
    next: usize,
    len: usize,
    /// How many frames the run has dealt with.
    done: Arc<AtomicUsize>,
    /// Frames that cannot be read.
    damaged: Option<usize>,
}

fn room(len: usize) -> Room {
    let camera = kinect_camera(160, 120).unwrap();
    Room {
        sequence: Sequence::new(1, len, camera, SensorModel::exact()),
        file: CameraFile::new(camera, None, 1000.0).unwrap(),
        next: 0,
        len,
        done: Arc::default(),
        damaged: None,
    }
}

impl CameraSource for Room {
    fn camera_file(&self) -> &CameraFile {
        &self.file
    }

    fn next_images(&mut self) -> Option<Result<LiveImages, DataError>> {
        let index = self.next;
        if index == self.len {
            return None;
        }
        self.next += 1;
        while self.done.load(Ordering::Relaxed) < index {
            sleep(Duration::from_millis(1));
        }
        if self.damaged == Some(index) {
            return Some(Err(DataError::NoSuchFrame {
                index,
                len: self.len,
            }));
        }
        let frame = self.sequence.frame(index);
        Some(Ok(LiveImages {
            timestamp_secs: 100.0 + frame.timestamp_secs,
            images: FrameImages {
                color: frame.color,
                depth_m: frame.depth_m,
                color_valid: None,
            },
        }))
    }
}

/// Counts the frames that are done.
struct Count(Arc<AtomicUsize>);

impl RunObserver for Count {
    fn on(&mut self, event: &RunEvent<'_>) {
        if let RunEvent::Frame { .. } = event {
            self.0.fetch_add(1, Ordering::Relaxed);
        }
    }
}

fn options(folder: &Path) -> RunOptions {
    RunOptions {
        backend: Some(Backend::Cpu),
        out: Some(folder.join("out")),
        ..RunOptions::default()
    }
}

fn run(options: &RunOptions, room: Room) -> Result<(Plan, RunResult), RunError> {
    let mut count = Count(Arc::clone(&room.done));
    let (plan, model) = Plan::resolve_live(options, "synthetic:room", Box::new(room))?;
    let result = plan.run(model, &mut count, &AtomicBool::new(false))?;
    Ok((plan, result))
}

#[test]
fn a_live_camera_is_tracked_and_everything_is_saved() {
    let folder = tempfile::tempdir().unwrap();
    let room = Room {
        damaged: Some(2),
        ..room(6)
    };
    let sequence = room.sequence.clone();
    let (plan, result) = run(&options(folder.path()), room).unwrap();
    let statuses: Vec<_> = result.rows.iter().map(|row| row.status).collect();
    let [tracked, damaged] = [FrameStatus::Tracked, FrameStatus::Damaged];
    assert_eq!(
        statuses,
        [tracked, tracked, damaged, tracked, tracked, tracked]
    );
    assert!(result.rows.iter().map(|row| row.index).eq(0..6));
    let first = sequence.world_from_camera(0);
    for pose in result.trajectory.poses() {
        let index = (30.0 * (pose.timestamp_secs - 100.0)).round() as usize;
        let truth = first.inverse() * sequence.world_from_camera(index);
        let error = (pose.world_from_camera.translation - truth.translation).norm();
        assert!(error < 0.01, "frame {index} is {error} m off");
    }
    let saved = RunFolder::open(plan.folder.path()).unwrap();
    assert_eq!(RunResult::read(&saved).unwrap().gaussians, result.gaussians);
    assert!(!result.gaussians.is_empty());
    for name in [MAP, TRAJECTORY, REPORT] {
        assert!(saved.join(name).is_file(), "{name}");
    }
    let settings = Settings::read(&saved.join(CONFIG)).unwrap();
    assert_eq!(
        settings.run.camera_source.as_deref(),
        Some("synthetic:room")
    );
    assert_eq!(settings.run.mode, Some(Execution::Realtime));
}

#[test]
fn so_many_frames_and_no_more() {
    let folder = tempfile::tempdir().unwrap();
    let options = RunOptions {
        frames: Some("..3".parse().unwrap()),
        ..options(folder.path())
    };
    let (plan, result) = run(&options, room(100)).unwrap();
    assert_eq!(result.rows.len(), 3);
    assert_eq!(plan.num_frames_left(), Some(3));
}

/// A live run's checkpoints are a map that another camera finds itself in.
#[test]
fn a_live_camera_extends_a_live_cameras_map() {
    let folder = tempfile::tempdir().unwrap();
    let first = RunOptions {
        checkpoint_every_secs: Some(0),
        ..options(folder.path())
    };
    run(&first, room(4)).unwrap();
    let resumed = RunOptions {
        known_map: Some(KnownMap::Resume(folder.path().join("out"))),
        ..RunOptions::default()
    };
    let error = Plan::resolve(&resumed).err().unwrap().to_string();
    assert!(error.contains("no run with them is resumed"), "{error}");
    let second = RunOptions {
        known_map: Some(KnownMap::LocalizeOnly(folder.path().join("out"))),
        out: Some(folder.path().join("again")),
        ..first
    };
    let second = RunOptions {
        checkpoint_every_secs: None,
        ..second
    };
    let (_, result) = run(&second, room(3)).unwrap();
    let found = |row: &crate::FrameRow| row.status == FrameStatus::Tracked;
    assert!(result.rows.iter().any(found), "{:?}", result.rows);
}

#[test]
fn what_needs_the_frames_again_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let usual = options(folder.path());
    let camera = folder.path().join("camera.toml");
    let large = CameraFile::new(kinect_camera(320, 240).unwrap(), None, 1000.0).unwrap();
    std::fs::write(&camera, toml::to_string(&large).unwrap()).unwrap();
    for (options, expected) in [
        (
            RunOptions {
                evaluate: true,
                ..usual.clone()
            },
            "record them",
        ),
        (
            RunOptions {
                execution: Some(Execution::Lockstep),
                ..usual.clone()
            },
            "real time",
        ),
        (
            RunOptions {
                frames: Some("2..5".parse().unwrap()),
                ..usual.clone()
            },
            "begins with the first",
        ),
        (
            RunOptions {
                camera: Some(camera),
                ..usual
            },
            "320x240",
        ),
    ] {
        let error = Plan::resolve_live(&options, "synthetic:room", Box::new(room(1)));
        let error = error.err().unwrap();
        assert!(error.is_usage(), "{error}");
        assert!(error.to_string().contains(expected), "{error}");
        assert!(!folder.path().join("out").exists());
    }
}
