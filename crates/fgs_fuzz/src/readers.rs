//! Readers of files.

use std::cell::OnceCell;
use std::fs;
use std::path::Path;

use fgs_data::{CameraFile, Dataset, OpenOptions, Trajectory};
use fgs_run::{Metrics, RunFolder, RunResult, Settings};
use image::{ImageBuffer, Luma, RgbImage};
use tempfile::TempDir;

const CAMERA: &str =
    "width = 8\nheight = 6\nfx = 8.0\nfy = 8.0\ncx = 3.5\ncy = 2.5\ndepth_scale = 1000.0\n";

/// A folder of this thread, made once.
pub(crate) fn in_folder<T>(
    make: fn(&Path),
    name: &'static str,
    work: impl FnOnce(&Path) -> T,
) -> T {
    thread_local! {
        static FOLDERS: OnceCell<TempDir> = const { OnceCell::new() };
    }
    FOLDERS.with(|folders| {
        let folder = folders.get_or_init(|| tempfile::tempdir().unwrap());
        let path = folder.path().join(name);
        if !path.exists() {
            fs::create_dir(&path).unwrap();
            make(&path);
        }
        work(&path)
    })
}

/// A recording of one frame.
fn recording(folder: &Path) {
    fs::write(folder.join("camera.toml"), CAMERA).unwrap();
    fs::write(folder.join("rgb.txt"), "0 rgb.png\n").unwrap();
    fs::write(folder.join("depth.txt"), "0 depth.png\n").unwrap();
    RgbImage::new(8, 6).save(folder.join("rgb.png")).unwrap();
    let depth = ImageBuffer::<Luma<u16>, Vec<u16>>::from_pixel(8, 6, Luma([2000]));
    depth.save(folder.join("depth.png")).unwrap();
}

/// A recording of one frame in Replica's layout.
fn replica(folder: &Path) {
    fs::write(folder.join("camera.toml"), CAMERA).unwrap();
    fs::create_dir(folder.join("results")).unwrap();
    for name in ["frame000.png", "depth000.png"] {
        RgbImage::new(8, 6)
            .save(folder.join("results").join(name))
            .unwrap();
    }
}

/// Opens a recording with one file replaced, and reads its frame.
fn open_with(make: fn(&Path), folder: &'static str, file: &str, bytes: &[u8]) {
    in_folder(make, folder, |path| {
        fs::write(path.join(file), bytes).unwrap();
        if let Ok(dataset) = Dataset::open(path, &OpenOptions::default()) {
            let _ = dataset.ground_truth_error().map(ToString::to_string);
            let frame = dataset.frame(0);
            if let Ok(frame) = frame {
                frame.check().unwrap();
            }
        }
    });
}

/// A camera file.
pub fn camera_file(bytes: &[u8]) {
    let Ok(text) = str::from_utf8(bytes) else {
        return open_with(recording, "camera", "camera.toml", bytes);
    };
    match CameraFile::parse(text, Path::new("camera.toml")) {
        Ok(file) => assert!(file.camera().width > 0 && file.depth_scale() >= 1.0),
        Err(error) => assert!(error.is_usage(), "{error}"),
    }
}

/// A list of images with times.
pub fn lists(bytes: &[u8]) {
    open_with(recording, "lists", "rgb.txt", bytes);
}

/// A trajectory, alone and as a recording's.
pub fn trajectory(bytes: &[u8]) {
    in_folder(recording, "trajectory", |path| {
        let file = path.join("groundtruth.txt");
        fs::write(&file, bytes).unwrap();
        if let Ok(trajectory) = Trajectory::read(&file) {
            for pose in trajectory.poses() {
                assert!(
                    pose.world_from_camera
                        .translation
                        .iter()
                        .all(|x| x.is_finite())
                );
                let velocity = trajectory.velocity(pose.timestamp_secs, 1.0);
                assert!(velocity.iter().all(|x| x.is_finite()), "{velocity}");
            }
        }
    });
    open_with(recording, "trajectory", "groundtruth.txt", bytes);
}

/// Poses as matrices.
pub fn matrices(bytes: &[u8]) {
    open_with(replica, "matrices", "traj.txt", bytes);
}

/// A colour image.
pub fn color_image(bytes: &[u8]) {
    open_with(recording, "color", "rgb.png", bytes);
}

/// A depth image.
pub fn depth_image(bytes: &[u8]) {
    open_with(recording, "depth", "depth.png", bytes);
}

/// A map.
pub fn map(bytes: &[u8]) {
    in_folder(
        |_| (),
        "map",
        |path| {
            let file = path.join("map.ply");
            fs::write(&file, bytes).unwrap();
            if let Ok(map) = fgs_splat::read_ply(&file) {
                // What is read can be written.
                fgs_splat::encode_ply(&mut std::io::sink(), &map).unwrap();
            }
        },
    );
}

/// A settings file.
pub fn settings(bytes: &[u8]) {
    in_folder(
        |_| (),
        "settings",
        |path| {
            let file = path.join("c.toml");
            fs::write(&file, bytes).unwrap();
            match Settings::read(&file) {
                Ok(settings) => settings.slam().validate().unwrap(),
                Err(error) => {
                    let message = error.to_string();
                    assert!(message.lines().count() <= 1, "{message}");
                }
            }
        },
    );
}

/// A file of a run's folder: the first byte says which.
pub fn run_folder(bytes: &[u8]) {
    let files = [
        "metrics.json",
        "frames.csv",
        "trajectory.txt",
        "config.effective.toml",
    ];
    let Some((which, bytes)) = bytes.split_first() else {
        return;
    };
    in_folder(
        |_| (),
        "run",
        |path| {
            for file in files {
                fs::write(path.join(file), "").unwrap();
            }
            let file = files[usize::from(*which) % files.len()];
            fs::write(path.join(file), bytes).unwrap();
            if let Ok(folder) = RunFolder::open(path) {
                if let Ok(metrics) = Metrics::read(&folder) {
                    let _ = metrics.table();
                }
                let _ = RunResult::read_rows(&folder);
            }
            let _ = Settings::read(&path.join("config.effective.toml"));
        },
    );
}
