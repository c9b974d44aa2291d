//! Maps that outlive their runs: runs that are killed and go on, and runs in a known map.

#![allow(clippy::unwrap_used, reason = "a test may panic, its helpers too")]

mod common;

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::thread::sleep;
use std::time::Duration;

use common::{FRAMES, fgs, folder_with_recording, metrics, names, rows, run, stderr};
use tempfile::TempDir;

const QUICK: [&str; 4] = [
    "--backend",
    "cpu",
    "--set",
    "mapping.iterations_per_frame=3",
];

/// A recording `room`, and in `whole` a run that nothing interrupted.
fn room_and_run(mode: &[&str]) -> (TempDir, PathBuf) {
    let folder = folder_with_recording();
    let arguments = [&["run", "room", "--out", "whole"], &QUICK[..], mode].concat();
    run(folder.path(), &arguments, 0);
    let path = folder.path().into();
    (folder, path)
}

/// Starts a program and waits until it has tracked so many frames; `false` if it ends before.
fn start_and_wait(path: &Path, arguments: &[&str], frames: usize) -> (Child, bool) {
    let mut child = fgs(path, &[arguments, &["--json"]].concat())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut tracked = lines.filter(|line| line.as_ref().unwrap().contains(r#""event":"frame""#));
    let reached = tracked.by_ref().take(frames).count() == frames;
    (child, reached)
}

/// As `kill -9` does.
fn kill((mut child, reached): (Child, bool), after: Duration) {
    assert!(reached);
    sleep(after);
    child.kill().unwrap();
    child.wait().unwrap();
}

fn without_times(run: &Path) -> Vec<std::collections::HashMap<String, String>> {
    let mut rows = rows(run);
    for row in &mut rows {
        row.remove("tracking_ms").unwrap();
    }
    rows
}

fn assert_same_results(path: &Path, run: &str) {
    let (run, whole) = (path.join(run), path.join("whole"));
    for file in ["trajectory.txt", "map.ply"] {
        assert!(
            fs::read(run.join(file)).unwrap() == fs::read(whole.join(file)).unwrap(),
            "{file}"
        );
    }
    assert_eq!(without_times(&run), without_times(&whole));
    let (run, whole) = (metrics(&run), metrics(&whole));
    for key in [
        "frames",
        "iterations",
        "keyframes",
        "num_gaussians",
        "interrupted",
    ] {
        assert_eq!(run[key], whole[key], "{key}");
    }
}

#[test]
fn the_last_checkpoint_of_a_killed_run_is_shown() {
    let folder = folder_with_recording();
    let path = folder.path();
    let checkpoints = ["run", "room", "--out", "cut", "--checkpoint-every", "0"];
    let arguments = [&checkpoints, &QUICK[..]].concat();
    kill(start_and_wait(path, &arguments, 4), Duration::ZERO);
    assert!(!path.join("cut").exists());
    for source in ["cut", "cut.map"] {
        run(path, &["view", source, "--export", "pages"], 0);
        let scene = fs::read_to_string(path.join("pages/scene.json")).unwrap();
        let scene: serde_json::Value = serde_json::from_str(&scene).unwrap();
        assert_eq!(scene["title"], "cut.map");
        let splats = fs::metadata(path.join("pages/map.splat")).unwrap().len() / 32;
        assert!(splats > 1000 && scene["gaussians"] == splats, "{splats}");
        let keyframes = scene["keyframes"].as_array().unwrap();
        assert_eq!(keyframes[0]["index"], 0);
        assert_eq!(scene["path"].as_array().unwrap().len(), keyframes.len());
        for keyframe in keyframes {
            for picture in ["input", "render"] {
                let picture = path.join("pages").join(keyframe[picture].as_str().unwrap());
                assert!(fs::read(picture).unwrap().starts_with(&[0xff, 0xd8]));
            }
        }
    }
    let states = names(&path.join("cut.map"));
    let state = states.iter().find(|name| name.contains("-state-")).unwrap();
    fs::write(path.join("cut.map").join(state), "no state").unwrap();
    let refused = stderr(&run(path, &["view", "cut", "--export", "others"], 1));
    assert!(
        refused.contains("checksum") && !path.join("others").exists(),
        "{refused}"
    );
}

#[test]
fn a_run_that_is_killed_again_and_again_ends_with_the_same_bytes() {
    let (_folder, path) = room_and_run(&["--eval-holdout", "5"]);
    let arguments = [
        &[
            "run",
            "room",
            "--out",
            "cut",
            "--checkpoint-every",
            "0",
            "--eval-holdout",
            "5",
        ],
        &QUICK[..],
    ]
    .concat();
    kill(start_and_wait(&path, &arguments, 4), Duration::ZERO);
    assert!(!path.join("cut").exists());
    let resume = ["run", "--resume", "cut"];
    for after_ms in [0, 3] {
        kill(
            start_and_wait(&path, &resume, 2),
            Duration::from_millis(after_ms),
        );
    }
    run(&path, &[&resume[..], &["--threads", "1"]].concat(), 0);
    assert_same_results(&path, "cut");
    // Nothing is left of what the killed runs were writing.
    let files = names(&path.join("cut.map"));
    let states = files.iter().filter(|name| name.starts_with("0-state-"));
    assert_eq!(states.count(), 1, "{files:?}");
    assert!(
        !files.iter().any(|name| name.ends_with("unfinished")),
        "{files:?}"
    );
    // There is nothing left to do but the end.
    run(&path, &["run", "room", "--resume", "cut.map"], 0);
    assert_same_results(&path, "cut");
}

#[cfg(unix)]
#[test]
fn a_run_that_was_stopped_goes_on() {
    let (_folder, path) = room_and_run(&[]);
    let arguments = [
        &["run", "room", "--out", "cut", "--checkpoint-every", "1000"],
        &QUICK[..],
    ]
    .concat();
    let (mut child, reached) = start_and_wait(&path, &arguments, 3);
    assert!(reached);
    let pid = child.id().to_string();
    let sent = std::process::Command::new("kill")
        .args(["-INT", &pid])
        .status();
    assert!(sent.unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    let tracked = rows(&path.join("cut")).len();
    assert!((3..FRAMES).contains(&tracked), "{tracked}");
    run(&path, &["run", "--resume", "cut"], 0);
    assert_same_results(&path, "cut");
}

#[test]
fn what_cannot_go_on_is_refused() {
    let folder = folder_with_recording();
    let path = folder.path();
    let arguments = [
        &["run", "room", "--checkpoint-every", "9", "--out", "a"],
        &QUICK[..],
    ];
    run(path, &arguments.concat(), 0);
    let refuse = |arguments: &[&str], exit_code: i32, part: &str| {
        let message = stderr(&run(path, arguments, exit_code));
        assert!(
            message.starts_with("error: ") && message.contains(part),
            "{message}"
        );
        assert_eq!(message.trim_end().lines().count(), 1, "{message}");
    };
    let resume = ["run", "--resume", "a"];
    refuse(&["run", "--resume", "room"], 2, "room holds no map");
    refuse(
        &["run", "room", "--map", "room", "--localize-only"],
        2,
        "room holds no map",
    );

    for (name, frames, size) in [("small", "12", "80x60"), ("short", "7", "160x120")] {
        let synth = [
            "synth", name, "--frames", frames, "--size", size, "--noise", "none",
        ];
        run(path, &synth, 0);
    }
    refuse(
        &["run", "small", "--resume", "a"],
        2,
        "its camera is another",
    );
    refuse(&["run", "small", "--map", "a"], 2, "its camera is another");
    refuse(
        &["run", "short", "--resume", "a"],
        2,
        "goes beyond the recording",
    );

    let map = path.join("a.map");
    for name in names(&map) {
        let file = map.join(&name);
        let whole = fs::read(&file).unwrap();
        let mut flipped = whole.clone();
        flipped[whole.len() / 2] ^= 16;
        fs::write(&file, flipped).unwrap();
        refuse(&resume, 1, &format!("{name} is damaged"));
        fs::write(&file, &whole[..whole.len() / 2]).unwrap();
        refuse(&resume, 1, &format!("{name} is damaged"));
        fs::remove_file(&file).unwrap();
        // Opening a pipe would wait for ever. Without a manifest there is no map to look into.
        #[cfg(unix)]
        if name != "manifest" {
            let made = std::process::Command::new("mkfifo").arg(&file).status();
            assert!(made.unwrap().success());
            refuse(&resume, 2, "is a named pipe");
            fs::remove_file(&file).unwrap();
        }
        fs::write(&file, whole).unwrap();
    }
    run(path, &resume, 0);
}

/// The map is of the first frames; the second recording goes through the room from the start again.
#[test]
fn a_camera_finds_itself_in_a_map_and_extends_it() {
    let folder = folder_with_recording();
    let path = folder.path();
    let mapped = [
        &[
            "run",
            "room",
            "--frames",
            "..8",
            "--checkpoint-every",
            "9",
            "--out",
            "a",
        ],
        &QUICK[..],
    ];
    run(path, &mapped.concat(), 0);
    let files = |folder: &str| {
        let names = names(&path.join(folder));
        names
            .iter()
            .map(|name| fs::read(path.join(folder).join(name)).unwrap())
            .collect::<Vec<_>>()
    };
    let before = files("a.map");
    let only = [
        "run",
        "room",
        "--map",
        "a",
        "--localize-only",
        "--out",
        "only",
    ];
    run(path, &[&only[..], &["--backend", "cpu"]].concat(), 0);
    assert!(files("a.map") == before);
    let only = path.join("only");
    assert_eq!(metrics(&only)["iterations"], 0);
    let statuses: Vec<String> = rows(&only)
        .iter()
        .map(|row| row["status"].clone())
        .collect();
    assert_eq!(statuses.len(), FRAMES);
    assert!(
        statuses[3..].iter().all(|status| status == "tracked"),
        "{statuses:?}"
    );
    assert!(rows(&only).iter().all(|row| row["keyframe"].is_empty()));
    assert!(!names(&only).contains(&"map".into()));

    // With a map of its own, that holds both, and in turn can be gone on with.
    let extend = [
        "run",
        "room",
        "--map",
        "a",
        "--checkpoint-every",
        "9",
        "--out",
        "b",
    ];
    run(path, &[&extend[..], &["--backend", "cpu"]].concat(), 0);
    assert!(files("a.map") == before);
    let keyframes = |folder: &str| {
        let names = names(&path.join(folder));
        names
            .iter()
            .filter(|name| name.contains("keyframe"))
            .count()
    };
    assert!(keyframes("b.map") > keyframes("a.map"));
    let settings = fs::read_to_string(path.join("b/config.effective.toml")).unwrap();
    assert!(settings.contains("iterations_per_frame = 3"), "{settings}");
    run(path, &["run", "--resume", "b"], 0);
    run(
        path,
        &["run", "room", "--map", "b", "--localize-only", "--out", "c"],
        0,
    );
}
