//! Broken recordings are refused with a message that says where and why, each its own.

#![allow(clippy::unwrap_used)]

mod common;

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use common::*;
use fgs_data::{DataError, Dataset, OpenOptions};
use image::{DynamicImage, RgbImage};

/// The message for a recording once `damage` has been done to it, with `DIR` for its folder.
fn message(recording: tempfile::TempDir, damage: impl FnOnce(&Path)) -> String {
    let root = recording.path();
    damage(root);
    let room = root.join("room");
    let folder = if room.exists() { &room } else { root };
    let open = || -> Result<(), String> {
        let in_words = |error: DataError| error.to_string();
        let dataset = Dataset::open(folder, &OpenOptions::default()).map_err(in_words)?;
        // Poses that cannot be used are no reason to refuse the recording.
        if let Some(error) = dataset.ground_truth_error() {
            assert_eq!(dataset.ground_truth(), None);
            dataset.frame(0).map_err(in_words)?;
            return Err(error.to_string());
        }
        dataset
            .frames(0..dataset.len())
            .try_for_each(|frame| frame.map(drop).map_err(in_words))
    };
    open()
        .unwrap_err()
        .replace(&root.display().to_string(), "DIR")
}

/// Replaces text in a file.
fn edit(path: &Path, from: &str, to: &str) {
    let text = fs::read_to_string(path).unwrap();
    assert!(text.contains(from));
    fs::write(path, text.replacen(from, to, 1)).unwrap();
}

fn cut(path: &Path) {
    let bytes = fs::read(path).unwrap();
    fs::write(path, &bytes[..bytes.len() * 3 / 4]).unwrap();
}

fn tum_messages() -> Vec<(String, &'static str)> {
    let lists = |from: &'static str, to: &'static str| {
        move |dir: &Path| edit(&dir.join("rgb.txt"), from, to)
    };
    let camera = |from: &'static str, to: &'static str| {
        move |dir: &Path| edit(&dir.join("camera.toml"), from, to)
    };
    vec![
        (
            message(tum(3), |dir| {
                fs::remove_file(dir.join("depth.txt")).unwrap()
            }),
            "DIR/depth.txt is missing: a TUM recording needs rgb.txt and depth.txt",
        ),
        (
            message(tum(3), |dir| {
                fs::write(dir.join("rgb.txt"), "# none\n").unwrap()
            }),
            "DIR/rgb.txt holds no entry",
        ),
        (
            message(tum(3), lists("100.033333", "100.o33333")),
            "DIR/rgb.txt:3: '100.o33333' is not a finite number",
        ),
        (
            message(tum(3), lists("rgb/1.png", "rgb/one.png")),
            "DIR/rgb.txt:3: DIR/rgb/one.png does not exist",
        ),
        (
            message(tum(3), lists("rgb/2.png", "rgb/2.png more")),
            "DIR/rgb.txt:4: expected 2 columns, found 3",
        ),
        (
            message(tum(3), lists("100.033333", "99")),
            "DIR/rgb.txt:3: time stamp 99 does not come after 100",
        ),
        (
            message(tum(1), lists("100.000000", "200")),
            "nothing in DIR/rgb.txt (200.000 to 200.000 s) is close in time to anything in \
             DIR/depth.txt (100.011 to 100.011 s)",
        ),
        (
            message(tum(3), |dir| {
                fs::write(
                    dir.join("groundtruth.txt"),
                    "1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n",
                )
                .unwrap();
            }),
            "nothing in DIR/groundtruth.txt (1.000 to 2.000 s) is close in time to anything in \
             DIR/rgb.txt (100.000 to 100.067 s)",
        ),
        (
            message(tum(3), |dir| {
                fs::write(dir.join("groundtruth.txt"), "# x\n1 0 0 NaN 0 0 0 1\n").unwrap();
            }),
            "DIR/groundtruth.txt:2: 'NaN' is not a finite number",
        ),
        (
            message(tum(3), |dir| {
                fs::remove_file(dir.join("camera.toml")).unwrap()
            }),
            "no camera is known for DIR: write DIR/camera.toml with these lines\n\
             width = 24\nheight = 16\n\
             fx = ?              # focal lengths, pixels\nfy = ?\n\
             cx = ?              # principal point, pixels; the first pixel's centre is 0\ncy = ?\n\
             depth_scale = ?     # value in the depth images that means 1 metre\n\
             distortion = [0.0, 0.0, 0.0, 0.0, 0.0] # k1, k2, p1, p2, k3; may be left out",
        ),
        (
            message(tum(3), camera("fy = 21.0\n", "")),
            "DIR/camera.toml: missing field `fy`",
        ),
        (
            message(tum(3), camera("20.0", "-20.0")),
            "DIR/camera.toml: fx = -20 is not possible: 2 to 2400 pixels",
        ),
        (
            message(tum(3), camera("fy", "fyy")),
            "DIR/camera.toml:4: unknown field `fyy`",
        ),
    ]
}

fn image_messages() -> Vec<(String, &'static str)> {
    vec![
        (
            message(tum(3), |dir| cut(&dir.join("rgb/1.png"))),
            "DIR/rgb/1.png: unexpected end of file",
        ),
        (
            message(replica(3), |dir| {
                cut(&dir.join("room/results/frame000001.jpg"))
            }),
            "DIR/room/results/frame000001.jpg: the JPEG image is cut short",
        ),
        (
            message(tum(3), |dir| fs::write(dir.join("rgb/1.png"), "").unwrap()),
            "DIR/rgb/1.png: The image format could not be determined",
        ),
        (
            message(tum(3), |dir| {
                RgbImage::new(16, 24).save(dir.join("rgb/1.png")).unwrap()
            }),
            "DIR/rgb/1.png is 16x24, but the camera is 24x16: colour, and depth registered to \
             it, must both have the camera's size",
        ),
        (
            message(tum(3), |dir| {
                DepthImage::new(12, 8)
                    .save(dir.join("depth/2.png"))
                    .unwrap()
            }),
            "DIR/depth/2.png is 12x8, but the camera is 24x16: colour, and depth registered to \
             it, must both have the camera's size",
        ),
        (
            message(tum(3), |dir| {
                let shallow = DynamicImage::from(depth(1)).to_luma8();
                shallow.save(dir.join("depth/1.png")).unwrap();
            }),
            "DIR/depth/1.png: depth must be one channel of 16 bits, not 1 of 8",
        ),
        (
            message(tum(3), |dir| save_color(&dir.join("depth/1.png"), 1)),
            "DIR/depth/1.png: depth must be one channel of 16 bits, not 3 of 8",
        ),
        (
            message(tum(3), |dir| save_depth(&dir.join("rgb/1.png"), 1)),
            "DIR/rgb/1.png: colour must have 8 bits a channel, not 16",
        ),
    ]
}

fn other_messages() -> Vec<(String, &'static str)> {
    vec![
        (
            message(tempfile::tempdir().unwrap(), |_| ()),
            "DIR holds no recording: expected rgb.txt and depth.txt (TUM), results/ (Replica), \
             frame-*.color.png (7-Scenes), or the folders rgb/ and depth/",
        ),
        (
            message(replica(3), |dir| {
                let room = dir.join("room");
                fs::remove_dir_all(&room).unwrap();
                fs::write(&room, "").unwrap();
            }),
            "DIR/room is not a folder",
        ),
        (
            message(replica(3), |dir| {
                fs::remove_file(dir.join("room/results/depth000001.png")).unwrap();
            }),
            "DIR/room/results/frame000001.jpg has no depth image DIR/room/results/depth000001.png",
        ),
        (
            message(replica(3), |dir| {
                let traj = matrix_lines(&pose_at(0.0), 16);
                fs::write(dir.join("room/traj.txt"), traj).unwrap();
            }),
            "DIR/room/traj.txt holds 1, but DIR/room/results holds 3",
        ),
        (
            message(replica(3), |dir| {
                let transposed = pose_at(0.0).matrix().transpose();
                let numbers: Vec<_> = transposed.transpose().iter().map(f64::to_string).collect();
                fs::write(dir.join("room/traj.txt"), numbers.join(" ")).unwrap();
            }),
            "DIR/room/traj.txt:1: the matrix is no rigid transform: a rotation, a translation, \
             and 0 0 0 1 below",
        ),
        (
            message(replica(3), |dir| {
                let far = "1 0 0 1e300 0 1 0 0 0 0 1 0 0 0 0 1\n";
                fs::write(dir.join("room/traj.txt"), far).unwrap();
            }),
            "DIR/room/traj.txt:1: 1e300 is out of range",
        ),
        (
            message(replica(3), |dir| {
                let overflow =
                    "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n1e400 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n";
                fs::write(dir.join("room/traj.txt"), overflow).unwrap();
            }),
            "DIR/room/traj.txt:2: '1e400' is not a finite number",
        ),
        (
            message(replica(3), |dir| {
                edit(&dir.join("cam_params.json"), "\"h\"", "\"hh\"")
            }),
            "DIR/room/../cam_params.json: missing field `h` at line 1",
        ),
        (
            message(seven_scenes(3), |dir| {
                fs::write(dir.join("frame-000002.pose.txt"), "1 0 0 0\n0 1 0 0\n").unwrap();
            }),
            "DIR/frame-000002.pose.txt holds no matrix of four lines",
        ),
        (
            message(folders(3), |dir| {
                fs::remove_file(dir.join("depth/d_9.png")).unwrap()
            }),
            "DIR/images/9.png has no partner: no image in DIR/depth has its number",
        ),
    ]
}

#[test]
fn each_kind_of_damage_has_its_message() {
    let cases = [tum_messages(), image_messages(), other_messages()].concat();
    for (message, expected) in &cases {
        // Behind it, the libraries' own words may follow.
        assert!(message.starts_with(expected), "{message}\n{expected}");
    }
    let distinct: BTreeSet<_> = cases.iter().map(|(message, _)| message).collect();
    assert_eq!(distinct.len(), cases.len());
    assert!(distinct.len() >= 25);
}

/// Bytes changed at random, in every kind of file: an error or a frame, never a panic or a hang.
#[test]
fn random_damage_never_panics() {
    let tum = tum(2);
    let replica = replica(2);
    let room = replica.path().join("room");
    let files = [
        tum.path().join("rgb.txt"),
        tum.path().join("groundtruth.txt"),
        tum.path().join("camera.toml"),
        tum.path().join("rgb/0.png"),
        tum.path().join("depth/0.png"),
        room.join("results/frame000000.jpg"),
        room.join("traj.txt"),
        replica.path().join("cam_params.json"),
    ];
    let mut state = 1u64;
    let mut random = |below: usize| {
        // Knuth's MMIX generator.
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 33) as usize % below
    };
    let mut refused = 0;
    for round in 0..400 {
        let path = &files[round % files.len()];
        let intact = fs::read(path).unwrap();
        let mut bytes = intact.clone();
        for _ in 0..=random(3) {
            let at = random(bytes.len().max(1));
            match random(3) {
                _ if bytes.is_empty() => {}
                0 => bytes[at] = random(256) as u8,
                1 => drop(bytes.drain(at..bytes.len().min(at + 1 + random(8)))),
                _ => bytes.truncate(at + 1),
            }
        }
        fs::write(path, bytes).unwrap();
        for folder in [tum.path(), &room] {
            match Dataset::open(folder, &OpenOptions::default()) {
                Ok(dataset) => refused += dataset.frames(0..2).filter(Result::is_err).count(),
                Err(_) => refused += 1,
            }
        }
        fs::write(path, intact).unwrap();
    }
    assert!(refused >= 200, "{refused}");
}
