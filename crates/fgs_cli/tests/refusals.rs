//! What cannot work is refused at once: the right exit code, one line that names file and line or
//! key, and nothing written.

#![allow(clippy::unwrap_used, reason = "a test may panic, its helpers too")]

mod common;

use std::fs;
use std::path::Path;

#[cfg(unix)]
use common::limited;
use common::{fgs, folder_with_recording, frame_files, names, run, stderr, stdout};

/// Expects a refusal in one line that holds all of `parts`.
fn refuse(folder: &Path, arguments: &[&str], exit_code: i32, parts: &[&str]) {
    let output = run(folder, arguments, exit_code);
    let message = stderr(&output);
    assert!(message.starts_with("error: "), "{arguments:?}: {message}");
    assert_eq!(
        message.trim_end().lines().count(),
        1,
        "{arguments:?}: {message}"
    );
    for part in parts {
        assert!(
            message.contains(part),
            "{arguments:?}: '{part}' is not in {message}"
        );
    }
    assert_eq!(stdout(&output), "", "{arguments:?}");
    assert_eq!(names(&folder.join("runs")), [""; 0], "{arguments:?}");
}

#[test]
fn bad_settings() {
    let folder = folder_with_recording();
    let path = folder.path();
    let write = |name: &str, text: &str| fs::write(path.join(name), text).unwrap();
    write("key.toml", "[mapping]\nprune_evry = 5\n");
    write("value.toml", "[mapping]\n\nprune_every = 0\n");
    write("type.toml", "seed = 'lucky'\n");
    write("syntax.toml", "seed = 1\n[mapping\n");
    write("camera.toml", "width = 160\nheight = 120\nfx = 1.0\n");
    write(
        "big.toml",
        "width = 640\nheight = 480\nfx = 525.0\nfy = 525.0\ncx = 319.5\ncy = 239.5\n\
         depth_scale = 5000.0\n",
    );
    for (file, parts) in [
        ("key.toml", ["key.toml:2:", "prune_evry"]),
        ("value.toml", ["value.toml:3:", "mapping.prune_every = 0"]),
        ("type.toml", ["type.toml:1:", "lucky"]),
        ("syntax.toml", ["syntax.toml:2:", ""]),
        ("absent.toml", ["absent.toml", ""]),
    ] {
        refuse(path, &["run", "room", "--config", file], 2, &parts);
    }
    refuse(
        path,
        &["run", "room", "--camera", "camera.toml"],
        2,
        &["camera.toml", "missing field `fy`"],
    );
    refuse(
        path,
        &["run", "room", "--camera", "absent.toml"],
        2,
        &["absent.toml"],
    );
    refuse(
        path,
        &["run", "room", "--camera", "big.toml"],
        2,
        &["160x120", "640x480"],
    );
    for set in [
        "mapping.prune_evry=5",
        "mapping.prune_every=0",
        "run.backend=abacus",
        "run.eval_holdout=1",
        "seed=x",
        "seed",
    ] {
        refuse(
            path,
            &["run", "room", "--set", set],
            2,
            &[&format!("--set {set}: ")],
        );
    }
    refuse(
        path,
        &["run", "room", "--frames", "5..99"],
        2,
        &["5..99", "12"],
    );
    refuse(path, &["run", "room", "--frames", "5..5"], 2, &["5..5"]);
}

#[test]
fn command_lines_that_make_no_sense() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [
        ["run", "room", "--frames", "5"].as_slice(),
        &["run", "room", "--threads", "0"],
        &["run", "room", "--mode", "fast"],
        &["run", "room", "--backend", "abacus"],
        &["run", "room", "--refine", "-1"],
        &["run", "room", "--eval-holdout", "1"],
        &["demo", "--backend", "abacus"],
        &["run"],
        &["walk"],
        &["synth", "room", "--size", "640"],
        &["synth", "room", "--frames", "0"],
    ] {
        let message = stderr(&run(folder.path(), arguments, 2));
        assert!(
            message.starts_with("error: ") || message.contains("Usage"),
            "{message}"
        );
    }
    refuse(
        folder.path(),
        &["synth", "room", "--size", "0x5"],
        2,
        &["--size", "width = 0"],
    );
    refuse(folder.path(), &["eval", "."], 2, &["config.effective.toml"]);
}

/// A machine may have a graphics device; where it has none, asking for it is refused.
#[test]
fn a_graphics_device_that_is_not_there() {
    let folder = folder_with_recording();
    let path = folder.path();
    let arguments = ["run", "room", "--frames", "..1", "--backend", "gpu"];
    let output = fgs(path, &arguments).output().unwrap();
    if !output.status.success() {
        refuse(path, &arguments, 2, &["--backend cpu"]);
        refuse(
            path,
            &["run", "room", "--set", "run.backend=gpu"],
            2,
            &["--backend cpu"],
        );
    }
}

#[test]
fn bad_recordings() {
    let folder = folder_with_recording();
    let path = folder.path();
    refuse(path, &["run", "absent"], 2, &["absent does not exist"]);
    fs::create_dir(path.join("empty")).unwrap();
    refuse(path, &["run", "empty"], 2, &["empty", "rgb.txt"]);
    refuse(path, &["synth", "room"], 1, &["room", "exists"]);

    let lists = path.join("room/depth.txt");
    let text = fs::read_to_string(&lists).unwrap();
    fs::write(&lists, text.replacen("0.033333 ", "later ", 1)).unwrap();
    refuse(path, &["run", "room"], 1, &["depth.txt:4:", "later"]);
    fs::write(&lists, text).unwrap();

    fs::remove_file(path.join("room/camera.toml")).unwrap();
    let message = stderr(&run(path, &["run", "room"], 2));
    assert!(
        message.starts_with("error: ") && message.contains("camera.toml"),
        "{message}"
    );
}

#[test]
fn nothing_can_be_read() {
    let folder = folder_with_recording();
    let path = folder.path();
    for index in 0..common::FRAMES {
        let [color, _] = frame_files(&path.join("room"), index);
        fs::write(color, "no picture").unwrap();
    }
    let message = stderr(&run(path, &["run", "room", "--out", "out"], 1));
    assert!(
        message.contains("error: none of the 12 frames could be read"),
        "{message}"
    );
    assert_eq!(names(&path.join("out")), [""; 0]);
}

#[test]
fn output_that_cannot_be_written() {
    let folder = folder_with_recording();
    let path = folder.path();
    fs::write(path.join("file"), "in the way").unwrap();
    refuse(
        path,
        &["run", "room", "--out", "file/out"],
        1,
        &["output folder file/out"],
    );
    refuse(
        path,
        &["run", "room", "--out", "file"],
        1,
        &["output folder file"],
    );
    refuse(path, &["render", "file"], 1, &["trajectory.txt"]);
    fs::copy(path.join("room/groundtruth.txt"), path.join("poses.txt")).unwrap();
    refuse(
        path,
        &["render", "file", "--trajectory", "poses.txt"],
        1,
        &["file"],
    );
}

/// A limit on the size of files stands in for a disk that fills up while the map is written.
#[test]
#[cfg(unix)]
fn a_disk_that_fills_up() {
    let folder = folder_with_recording();
    let limits = "trap '' XFSZ; ulimit -f 40";
    let arguments = "run room --out out --frames 0..6";
    let output = limited(folder.path(), limits, arguments).output().unwrap();
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(
        message.starts_with("error: cannot write out/map.ply: ")
            && message.contains("; the other results are in out"),
        "{message}"
    );
    assert_eq!(message.trim_end().lines().count(), 1, "{message}");
    let left = names(&folder.path().join("out"));
    assert!(!left.iter().any(|name| name.contains("map")), "{left:?}");
    // All that does fit is there.
    for file in ["frames.csv", "metrics.json", "trajectory.txt"] {
        assert!(left.iter().any(|name| name == file), "{file}: {left:?}");
    }
}

#[test]
fn live_cameras_that_cannot_be() {
    let folder = folder_with_recording();
    let refuse = |arguments: &[&str], parts: &[&str]| refuse(folder.path(), arguments, 2, parts);
    refuse(&["run", "--camera-source", "webcam:0"], &["webcam", "ros2"]);
    refuse(&["run", "--camera-source", "ros2"], &["ros2"]);
    for option in [
        &["--eval"][..],
        &["room"],
        &["--mode", "lockstep"],
        &["--resume", "runs/x"],
    ] {
        let arguments = [&["run", "--camera-source", "ros2:/camera"][..], option].concat();
        let output = run(folder.path(), &arguments, 2);
        assert!(
            stderr(&output).contains("cannot be used with"),
            "{option:?}"
        );
    }
}
