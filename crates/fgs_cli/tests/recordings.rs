//! Recordings as other programs write them, from end to end: the same as from plain folders.

#![allow(clippy::unwrap_used, reason = "a test may panic, its helpers too")]

mod common;
#[path = "../../fgs_recordings/tests/common/mod.rs"]
mod walk;

use std::fs;
use std::path::Path;

use common::{fgs, metrics, names, rows, run, stderr, stdout};
use serde_json::Value;
use walk::bag::Transport;
use walk::{FRAMES, Walk};

fn track(folder: &Path, recording: &str, out: &str) -> String {
    run(
        folder,
        &["run", recording, "--out", out, "--backend", "cpu"],
        0,
    );
    fs::read_to_string(folder.join(out).join("trajectory.txt")).unwrap()
}

/// Tracking, mapping and the times of the sensors see nothing of the format.
#[test]
fn trajectories_are_those_of_plain_folders() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let walk = Walk::new();
    walk.write_plain(&path.join("plain"));
    walk.write_record3d(&path.join("walk.r3d"));
    walk.write_stray(&path.join("stray"));
    walk.write_bag(&path.join("walk.mcap"), Transport::JpegAndRaw);
    let expected = track(path, "plain", "out-plain");
    assert_eq!(expected.lines().count(), 1 + FRAMES);
    let truth = metrics(&path.join("out-plain"));
    assert!(truth["ate_rmse_m"].as_f64().unwrap() < 0.02, "{truth}");
    assert_eq!(truth["reference_is_device"], Value::Null);
    for (recording, out) in [
        ("walk.r3d", "out-r3d"),
        ("stray", "out-stray"),
        ("walk.mcap", "out-mcap"),
    ] {
        assert!(track(path, recording, out) == expected, "{recording}");
    }
    // The device's poses are the truth here; that is not known.
    let device = metrics(&path.join("out-stray"));
    assert_eq!(device["ate_rmse_m"], truth["ate_rmse_m"]);
    assert_eq!(device["reference_is_device"], Value::Bool(true));
    let page = fs::read_to_string(path.join("out-stray/report.html")).unwrap();
    assert!(page.contains("the device's own estimate"));
    assert_eq!(metrics(&path.join("out-mcap"))["ate_rmse_m"], Value::Null);
}

/// What comes after a run opens the recording again.
#[test]
fn everything_else_works_with_them_too() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    Walk::new().write_record3d(&path.join("walk.r3d"));
    run(
        path,
        &[
            "run",
            "walk.r3d",
            "--out",
            "out",
            "--backend",
            "cpu",
            "--frames",
            "0..8",
            "--eval",
            "--checkpoint-every",
            "0",
        ],
        0,
    );
    let scored = rows(&path.join("out"));
    assert!(scored.iter().all(|row| !row["psnr_db"].is_empty()));
    run(path, &["run", "--resume", "out"], 0);
    run(path, &["eval", "out"], 0);
    run(
        path,
        &[
            "run",
            "walk.r3d",
            "--map",
            "out",
            "--localize-only",
            "--out",
            "found",
            "--frames",
            "4..8",
        ],
        0,
    );
    let doctor = stdout(&run(path, &["doctor", "walk.r3d"], 0));
    assert!(doctor.contains("format        Record3D"), "{doctor}");
    assert!(
        doctor.contains("the device's own poses of 12 frames"),
        "{doctor}"
    );
    run(path, &["export", "out", "--to", "nerfstudio"], 0);
}

#[test]
fn imported_recordings_are_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    Walk::new().write_record3d(&path.join("walk.r3d"));
    let direct = track(path, "walk.r3d", "direct");
    let said = stderr(&run(path, &["import", "walk.r3d", "a/plain"], 0));
    let said = said + &stdout(&run(path, &["import", "a/plain", "again"], 0));
    assert!(said.contains("12 frames (TUM RGB-D)"), "{said}");
    assert!(names(&path.join("again")).contains(&"device_poses.txt".to_owned()));
    assert!(track(path, "again", "imported") == direct);
    let again = metrics(&path.join("imported"));
    assert_eq!(again["reference_is_device"], Value::Bool(true));
    let refused = stderr(&run(path, &["import", "walk.r3d", "again"], 1));
    assert!(refused.contains("exists already"), "{refused}");
}

/// A phone's depth has fewer pixels than its colour.
#[test]
fn a_phones_frames_are_tracked() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let mut walk = Walk::with_size(320, 240);
    for frame in &mut walk.frames {
        // The middle of each 4 x 4, as a sensor with larger pixels would measure.
        let depth = &frame.depth_mm;
        frame.depth_mm = fgs_geom::Image::from_fn(80, 60, |u, v| depth.at(4 * u + 2, 4 * v + 2));
    }
    walk.write_stray(&path.join("stray"));
    track(path, "stray", "out");
    let metrics = metrics(&path.join("out"));
    assert_eq!(metrics["frames_lost"], 0);
    assert!(metrics["ate_rmse_m"].as_f64().unwrap() < 0.01, "{metrics}");
}

/// A program in ffmpeg's place gives the frames from the one that it is asked for.
#[cfg(unix)]
#[test]
fn a_video_is_decoded_by_ffmpeg() {
    use std::os::unix::fs::PermissionsExt;

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let walk = Walk::new();
    walk.write_stray(&path.join("images"));
    walk.write_stray(&path.join("video"));
    fs::remove_dir_all(path.join("video/rgb")).unwrap();
    for (index, frame) in walk.frames.iter().enumerate() {
        let pixels = image::load_from_memory(&frame.jpeg).unwrap().into_rgb8();
        let mut bytes = format!("P6\n{} {}\n255\n", pixels.width(), pixels.height()).into_bytes();
        bytes.extend(pixels.into_raw());
        fs::write(path.join(format!("{index}.ppm")), bytes).unwrap();
    }
    let program = "#!/bin/sh\n\
        n=$(printf '%s' \"$*\" | sed -n 's/.*file:video.rgb.mp4.*gte(n\\\\,\\([0-9]*\\)).*/\\1/p')\n\
        while [ -e $n.ppm ]; do cat $n.ppm || exit; n=$((n + 1)); done\n";
    let ffmpeg = path.join("ffmpeg");
    fs::write(&ffmpeg, program).unwrap();
    fs::set_permissions(&ffmpeg, fs::Permissions::from_mode(0o755)).unwrap();
    let programs = format!("{}:/usr/bin:/bin", path.display());
    let arguments = ["run", "video", "--out", "out", "--backend", "cpu"];
    let output = fgs(path, &arguments)
        .env("PATH", programs)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let decoded = fs::read_to_string(path.join("out/trajectory.txt")).unwrap();
    assert!(decoded == track(path, "images", "expected"));
}

#[test]
fn what_is_missing_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    Walk::new().write_stray(&path.join("stray"));
    fs::remove_dir_all(path.join("stray/rgb")).unwrap();
    // Where nothing is installed.
    let output = fgs(path, &["doctor", "stray"]).env("PATH", "").output();
    let refused = stderr(&output.unwrap());
    let command = "ffmpeg -noautorotate -i 'stray/rgb.mp4' -fps_mode passthrough -start_number 0";
    assert!(refused.contains(command), "{refused}");
    fs::write(path.join("notes.txt"), "nothing").unwrap();
    let refused = stderr(&run(path, &["run", "notes.txt"], 2));
    for known in [
        "TUM",
        "Record3D",
        "Stray Scanner",
        "MCAP",
        "nerfstudio",
        "Polycam",
    ] {
        assert!(refused.contains(known), "{known}: {refused}");
    }
}
