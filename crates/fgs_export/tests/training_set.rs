//! COLMAP and nerfstudio folders, parsed by their published layouts: a point of the world falls on the
//! pixel on which our camera sees it.

#![allow(clippy::unwrap_used, reason = "a test may panic, its helpers too")]

use std::fs;
use std::ops::ControlFlow;
use std::path::Path;

use fgs_data::{Dataset, OpenOptions, Trajectory};
use fgs_export::{ExportError, Keyframe, Point, TrainingSet};
use fgs_synth::{SensorModel, Sequence, kinect_camera, write_tum};
use nalgebra::{Matrix4, Quaternion, UnitQuaternion, Vector3};
use serde_json::Value;
use tempfile::TempDir;

const POINTS: [Point; 2] = [
    Point {
        position: [0.5, -1.0, 3.0],
        color: [1, 2, 3],
    },
    Point {
        position: [1.5, 0.25, -2.0],
        color: [255, 0, 7],
    },
];

const COLMAP: Write = |set, path, on_image| set.write_colmap(path, on_image);
const NERFSTUDIO: Write = |set, path, on_image| set.write_nerfstudio(path, on_image);

/// Written by `write` to a folder `set`: frames 0 and 2 of a recording whose depth is registered.
struct Written {
    folder: TempDir,
    dataset: Dataset,
    keyframes: Vec<Keyframe>,
}

type Write =
    fn(&TrainingSet, &Path, &mut dyn FnMut() -> ControlFlow<()>) -> Result<(), ExportError>;

impl Written {
    /// `camera_toml` is added to the recording's camera file.
    fn new(camera_toml: &str, write: Write) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let room = folder.path().join("room");
        let camera = kinect_camera(64, 48).unwrap();
        let sequence = Sequence::new(3, 3, camera, SensorModel::exact());
        write_tum(&sequence, &room, |_| ControlFlow::Continue(())).unwrap();
        let camera_file = room.join("camera.toml");
        let text = fs::read_to_string(&camera_file).unwrap() + camera_toml;
        fs::write(&camera_file, text).unwrap();
        let dataset = Dataset::open(&room, &OpenOptions::default()).unwrap();
        let keyframes: Vec<_> = [0, 2]
            .map(|index| Keyframe {
                index,
                world_from_camera: sequence.world_from_camera(index),
            })
            .into();
        let trajectory = Trajectory::new([]).unwrap();
        let set = TrainingSet {
            dataset: &dataset,
            trajectory: &trajectory,
            keyframes: &keyframes,
            points: &POINTS,
        };
        let path = folder.path().join("set");
        let stopped = write(&set, &path, &mut || ControlFlow::Break(())).unwrap_err();
        assert!(matches!(stopped, ExportError::Stopped), "{stopped}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "only room");
        let mut images = 0;
        let mut count = || {
            images += 1;
            ControlFlow::Continue(())
        };
        write(&set, &path, &mut count).unwrap();
        let exists = write(&set, &path, &mut count).unwrap_err();
        assert!(matches!(exists, ExportError::Exists { .. }), "{exists}");
        assert_eq!(images, 2);
        Self {
            folder,
            dataset,
            keyframes,
        }
    }

    fn path(&self, name: &str) -> std::path::PathBuf {
        self.folder.path().join("set").join(name)
    }

    /// A few points in front of keyframe i, in the world, with the pixels on which our camera sees
    /// them, counted from the corner of the image.
    fn seen(&self, i: usize) -> Vec<(Vector3<f64>, [f64; 2])> {
        let camera = self.dataset.camera();
        let pixels = [[0.0, 0.0], [63.0, 10.0], [20.5, 47.0]];
        let seen = pixels.map(|[u, v]| {
            let point = camera.unproject(u, v, 2.0 + u / 64.0);
            let point = self.keyframes[i].world_from_camera.transform(&point);
            (point, [u + 0.5, v + 0.5])
        });
        seen.into()
    }

    fn assert_image_is_frame(&self, path: &Path, i: usize) {
        let image = image::open(path).unwrap().into_rgb8();
        let frame = self.dataset.frame(self.keyframes[i].index).unwrap();
        assert_eq!(image.as_raw(), frame.color.data().as_flattened());
    }
}

fn lines(path: &Path) -> Vec<Vec<String>> {
    let text = fs::read_to_string(path).unwrap();
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    lines
        .map(|line| line.split_whitespace().map(Into::into).collect())
        .collect()
}

fn numbers(columns: &[String]) -> Vec<f64> {
    columns
        .iter()
        .map(|column| column.parse().unwrap())
        .collect()
}

#[test]
fn colmap() {
    let written = Written::new("", COLMAP);
    let model = written.path("sparse/0");
    let cameras = lines(&model.join("cameras.txt"));
    assert_eq!(cameras.len(), 1);
    assert_eq!(cameras[0][..4], ["1", "PINHOLE", "64", "48"]);
    let [fx, fy, cx, cy] = numbers(&cameras[0][4..]).try_into().unwrap();

    let images = lines(&model.join("images.txt"));
    assert_eq!(images.len(), 4);
    for i in 0..2 {
        let line = &images[2 * i];
        assert_eq!(line[0], (i + 1).to_string());
        assert_eq!(line[8..], ["1".to_owned(), format!("00000{}.png", 2 * i)]);
        assert!(images[2 * i + 1].is_empty());
        let [w, x, y, z, tx, ty, tz] = numbers(&line[1..8]).try_into().unwrap();
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        for (point, pixel) in written.seen(i) {
            let p = rotation * point + Vector3::new(tx, ty, tz);
            let read = [fx * p.x / p.z + cx, fy * p.y / p.z + cy];
            assert!((0..2).all(|axis| (read[axis] - pixel[axis]).abs() <= 1e-9));
        }
        written.assert_image_is_frame(&written.path("images").join(&line[9]), i);
    }
    let points = lines(&model.join("points3D.txt"));
    assert_eq!(points[0], ["1", "0.5", "-1", "3", "1", "2", "3", "0"]);
    assert_eq!(points[1], ["2", "1.5", "0.25", "-2", "255", "0", "7", "0"]);
    assert!(!written.path("masks").exists());
}

#[test]
fn nerfstudio() {
    let written = Written::new("", NERFSTUDIO);
    let text = fs::read_to_string(written.path("transforms.json")).unwrap();
    let json: Value = serde_json::from_str(&text).unwrap();
    let number = |key: &str| json[key].as_f64().unwrap();
    assert_eq!((number("w"), number("h")), (64.0, 48.0));
    for i in 0..2 {
        let frame = &json["frames"][i];
        let rows: Vec<Vec<f64>> =
            serde_json::from_value(frame["transform_matrix"].clone()).unwrap();
        let pose = Matrix4::from_fn(|row, column| rows[row][column]);
        for (point, pixel) in written.seen(i) {
            // OpenGL's camera looks along -z, with y up.
            let p = pose.try_inverse().unwrap() * point.push(1.0);
            let read = [
                number("cx") + number("fl_x") * p.x / -p.z,
                number("cy") - number("fl_y") * p.y / -p.z,
            ];
            assert!((0..2).all(|axis| (read[axis] - pixel[axis]).abs() <= 1e-9));
        }
        let image = frame["file_path"].as_str().unwrap();
        written.assert_image_is_frame(&written.path(image), i);
        assert!(frame.get("mask_path").is_none());
    }
    let points = written.path(json["ply_file_path"].as_str().unwrap());
    assert!(fs::read(points).unwrap().starts_with(b"ply\n"));
}

/// The border that removing distortion leaves is masked, in both folders by the same file.
#[test]
fn pixels_that_the_camera_did_not_see_are_masked() {
    let [_, nerfstudio] = [COLMAP, NERFSTUDIO].map(|write| {
        let written = Written::new("distortion = [0.3, 0.0, 0.0, 0.0, 0.0]\n", write);
        let mask = image::open(written.path("masks/000002.png.png")).unwrap();
        let frame = written.dataset.frame(2).unwrap();
        let mut seen = 0;
        for (u, v, pixel) in mask.into_luma8().enumerate_pixels() {
            let has_color = frame.has_color(u as usize, v as usize);
            assert_eq!(pixel.0, [if has_color { 255 } else { 0 }]);
            seen += usize::from(has_color);
        }
        assert!(seen > 1500 && seen < 64 * 48, "{seen}");
        written
    });
    let text = fs::read_to_string(nerfstudio.path("transforms.json")).unwrap();
    let json: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(json["frames"][1]["mask_path"], "masks/000002.png.png");
}
