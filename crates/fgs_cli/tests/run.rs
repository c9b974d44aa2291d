//! Whole runs: what they leave, that they can be repeated, scored and rendered.

#![allow(clippy::unwrap_used, reason = "a test may panic, its helpers too")]

mod common;

use std::collections::HashMap;
use std::fs;
use std::path::Path;

use common::{
    FRAMES, folder_with_recording, frame_files, metrics, names, rows, run, stderr, stdout,
};
#[cfg(unix)]
use common::{fgs, interrupt_at};
use serde_json::Value;

const FILES: [&str; 10] = [
    ".fgs-files",
    "config.effective.toml",
    "frames.csv",
    "map.ply",
    "metrics.json",
    "pictures",
    "reference.txt",
    "report.html",
    "trajectory.txt",
    "up.txt",
];

const COUNTS: [&str; 15] = [
    "frames",
    "frames_dropped",
    "frames_lost",
    "frames_weak",
    "frames_damaged",
    "fps",
    "tracking_ms",
    "mapping_ms",
    "iterations",
    "iterations_per_frame",
    "keyframes",
    "loops",
    "num_gaussians",
    "map_bytes",
    "seed",
];

const TRAJECTORY_SCORES: [&str; 3] = ["ate_rmse_m", "ate_mean_m", "rpe_mean_m"];

const IMAGE_SCORES: [&str; 8] = [
    "psnr_valid_depth_db",
    "psnr_db",
    "psnr_paper_db",
    "psnr_exposure_valid_depth_db",
    "psnr_exposure_db",
    "psnr_heldout_db",
    "ssim",
    "depth_l1_m",
];

fn assert_same_bytes(a: &Path, b: &Path) {
    for file in ["trajectory.txt", "map.ply"] {
        assert!(
            fs::read(a.join(file)).unwrap() == fs::read(b.join(file)).unwrap(),
            "{file}"
        );
    }
}

/// Eight finite columns, times increasing, quaternions of length 1.
fn assert_strict_trajectory(run: &Path, poses: usize) {
    let text = fs::read_to_string(run.join("trajectory.txt")).unwrap();
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    let mut last = f64::NEG_INFINITY;
    let mut count = 0;
    for line in lines {
        let columns: Vec<f64> = line
            .split(' ')
            .map(|column| column.parse().unwrap())
            .collect();
        assert_eq!(columns.len(), 8, "{line}");
        assert!(columns.iter().all(|x| x.is_finite()), "{line}");
        assert!(columns[0] > last, "{line}");
        last = columns[0];
        let length: f64 = columns[4..].iter().map(|q| q * q).sum();
        assert!((length - 1.0).abs() <= 1e-9, "{line}");
        count += 1;
    }
    assert_eq!(count, poses);
}

#[test]
fn runs_repeat_and_can_be_scored_and_rendered() {
    let folder = folder_with_recording();
    let path = folder.path();
    // A hole in the depth, so that scores over valid and over all pixels differ.
    let [_, depth] = frame_files(&path.join("room"), 3);
    let mut image = image::open(&depth).unwrap().into_luma16();
    for (u, _, pixel) in image.enumerate_pixels_mut() {
        if u < 40 {
            pixel.0 = [0];
        }
    }
    image.save(depth).unwrap();
    run(
        path,
        &[
            "run",
            "room",
            "--mode",
            "lockstep",
            "--backend",
            "cpu",
            "--threads",
            "1",
            "--eval",
        ],
        0,
    );
    run(
        path,
        &["run", "room", "--backend", "cpu", "--threads", "2"],
        0,
    );
    let (first, second) = (path.join("runs/room"), path.join("runs/room-2"));
    assert_same_bytes(&first, &second);

    for run in [&first, &second] {
        assert_eq!(names(run), FILES);
        assert_strict_trajectory(run, FRAMES);
        assert_eq!(rows(run).len(), FRAMES);
        let metrics = metrics(run);
        for key in COUNTS.iter().chain(&TRAJECTORY_SCORES) {
            assert!(metrics[key].is_number(), "{key}: {metrics}");
        }
        assert_eq!(metrics["frames"], FRAMES);
        assert_eq!(metrics["frames_lost"], 0);
        assert_eq!(metrics["lpips"], Value::Null);
        assert_eq!(metrics["dataset"], "../../room");
        assert_eq!(metrics["mode"], "lockstep");
        assert_eq!(metrics["backend"], "CPU");
        assert_eq!(metrics["failure"], Value::Null);
        assert!(metrics["commit"].is_string());
        let bytes = fs::metadata(run.join("map.ply")).unwrap().len();
        assert_eq!(metrics["map_bytes"], bytes);
        // Exact depth and twelve calm frames: a tracker that works is within millimetres.
        assert!(metrics["ate_rmse_m"].as_f64().unwrap() <= 0.01, "{metrics}");
    }
    if cfg!(target_os = "linux") {
        assert!(metrics(&first)["peak_rss_bytes"].as_u64().unwrap() >= 1 << 20);
    }
    let (scored, unscored) = (metrics(&first), metrics(&second));
    for key in IMAGE_SCORES {
        assert!(scored[key].is_number(), "{key}: {scored}");
        assert_eq!(unscored[key], Value::Null, "{key}");
    }
    assert!(
        names(&first.join("pictures"))
            .iter()
            .any(|name| name.starts_with("worst-frame"))
    );

    let rows = rows(&first);
    let mean = |key: &str, keyframes_too: bool| {
        let counts = |row: &&HashMap<String, String>| keyframes_too || row["keyframe"].is_empty();
        let values: Vec<f64> = rows
            .iter()
            .filter(counts)
            .map(|row| row[key].parse().unwrap())
            .collect();
        values.iter().sum::<f64>() / values.len() as f64
    };
    for (key, column, keyframes_too) in [
        ("psnr_db", "psnr_db", true),
        ("psnr_valid_depth_db", "psnr_valid_depth_db", true),
        ("psnr_heldout_db", "psnr_valid_depth_db", false),
        ("ssim", "ssim", true),
    ] {
        let error = scored[key].as_f64().unwrap() - mean(column, keyframes_too);
        assert!(error.abs() <= 1e-9, "{key}: {error}");
    }
    assert_ne!(scored["psnr_heldout_db"], scored["psnr_valid_depth_db"]);
    assert!(scored["psnr_db"].as_f64().unwrap() >= 18.0, "{scored}");

    // The reference lies in the run's coordinates: what is left is the trajectory's error.
    let positions = |file: &str| {
        let text = fs::read_to_string(first.join(file)).unwrap();
        let lines = text.lines().filter(|line| !line.starts_with('#'));
        let numbers = lines.flat_map(|line| line.split(' ').skip(1).take(3));
        numbers.map(|x| x.parse().unwrap()).collect::<Vec<f64>>()
    };
    let (estimated, reference) = (positions("trajectory.txt"), positions("reference.txt"));
    assert_eq!(estimated.len(), reference.len());
    let pairs = estimated.iter().zip(&reference);
    let squares: f64 = pairs.map(|(a, b)| (a - b).powi(2)).sum();
    let error = (squares / FRAMES as f64).sqrt() - scored["ate_rmse_m"].as_f64().unwrap();
    assert!(error.abs() <= 1e-9, "{error}");

    let report = |run: &Path| fs::read_to_string(run.join("report.html")).unwrap();
    assert!(!report(&second).contains("<code>ssim</code>"));
    run(path, &["eval", "runs/room-2"], 0);
    for report in [report(&first), report(&second)] {
        // The room has ground truth: errors have colours and a plot.
        for part in [
            "<code>ssim</code>",
            "Position error",
            "best-frame-",
            "data:image/jpeg",
        ] {
            assert!(report.contains(part), "{part}");
        }
        assert!(!report.contains(&*path.to_string_lossy()));
        // Named as the folder that it ends up in.
        assert!(report.contains("<h1>room"));
    }
    run(
        path,
        &["compare", "runs/room", "runs/room-2", "--out", "both.html"],
        0,
    );
    let comparison = fs::read_to_string(path.join("both.html")).unwrap();
    assert!(comparison.contains("<th class=\"number\">room-2</th>"));
    run(
        path,
        &[
            "compare",
            "runs/room",
            "runs/room-2",
            "--out",
            "runs/room/map.ply",
        ],
        2,
    );
    run(path, &["compare", "runs/room", "room"], 2);
    let evaluated = metrics(&second);
    for key in IMAGE_SCORES.iter().chain(&TRAJECTORY_SCORES) {
        // Quaternions are normalised again on reading, which may change their last bits.
        let (again, before) = (
            evaluated[key].as_f64().unwrap(),
            scored[key].as_f64().unwrap(),
        );
        assert!(
            (again - before).abs() <= 1e-9 * before,
            "{key}: {again} {before}"
        );
    }

    run(
        path,
        &[
            "run",
            "room",
            "--config",
            "runs/room/config.effective.toml",
            "--out",
            "again",
        ],
        0,
    );
    assert_same_bytes(&first, &path.join("again"));
    let config = |run: &str| {
        let text = fs::read_to_string(path.join(run).join("config.effective.toml")).unwrap();
        let differs = |line: &str| line.starts_with("command =") || line.starts_with("dataset =");
        let lines = text.lines().filter(|line| !differs(line));
        lines.map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(config("runs/room"), config("again"));

    run(path, &["render", "runs/room", "--views", "3"], 0);
    let size = ["--size", "80x40", "--fov", "70"];
    let fly = [
        "render",
        "runs/room/map.ply",
        "--fly-through",
        "--views",
        "4",
        "--out",
        "film",
    ];
    run(path, &[fly.as_slice(), &size].concat(), 0);
    assert_eq!(
        names(&first.join("views")),
        [".fgs-files", "000000.png", "000001.png", "000002.png"]
    );
    assert_eq!(names(&path.join("film")).len(), 5);
    let picture = image::open(path.join("film/000000.png")).unwrap();
    assert_eq!((picture.width(), picture.height()), (80, 40));
    // The first view shows the first frame.
    let view = image::open(first.join("views/000000.png"))
        .unwrap()
        .into_rgb8();
    let frame = image::open(&frame_files(&path.join("room"), 0)[0])
        .unwrap()
        .into_rgb8();
    let pairs = view.as_raw().iter().zip(frame.as_raw());
    let error: f64 = pairs.map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
    assert!(error / view.as_raw().len() as f64 <= 25.0, "{error}");
}

#[test]
fn settings_and_frames_of_the_command_line_hold() {
    let folder = folder_with_recording();
    let path = folder.path();
    fs::write(
        path.join("c.toml"),
        "seed = 5\n[mapping]\nprune_every = 3\n",
    )
    .unwrap();
    let sets = [
        "--set",
        "seed=9",
        "--set",
        "mapping.iterations_per_frame=0.5",
    ];
    let arguments = [
        "run",
        "room",
        "--config",
        "c.toml",
        "--out",
        "out",
        "--frames",
        "2..8",
        "--backend",
        "cpu",
    ];
    let output = run(path, &[arguments.as_slice(), &sets].concat(), 0);
    assert!(stdout(&output).contains("computing on the CPU\n"));
    let metrics = metrics(&path.join("out"));
    assert_eq!(metrics["seed"], 9);
    assert_eq!(metrics["backend"], "CPU");
    assert_eq!(metrics["frames"], 6);
    assert_eq!(metrics["iterations"], 3);
    assert_eq!(rows(&path.join("out"))[0]["index"], "2");
    let config = fs::read_to_string(path.join("out/config.effective.toml")).unwrap();
    for line in [
        "fx = 131.25",
        "seed = 9",
        "prune_every = 3",
        "iterations_per_frame = 0.5",
        "backend = \"cpu\"",
        "frames = \"2..8\"",
    ] {
        assert!(config.contains(line), "{line} is not in\n{config}");
    }
    // Settings with a [camera] table are a camera file too.
    let camera = ["--camera", "out/config.effective.toml"];
    run(path, &[&["doctor", "room"], camera.as_slice()].concat(), 0);
    let first = ["run", "room", "--frames", "..1", "--out", "first"];
    run(path, &[first.as_slice(), &camera].concat(), 0);
}

#[test]
fn replica_layout_and_every_mode() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let size = ["--frames", "6", "--size", "161x121"];
    run(
        path,
        &[&["synth", "room", "--layout", "replica"], size.as_slice()].concat(),
        0,
    );
    for mode in ["parallel", "realtime"] {
        run(path, &["run", "room", "--mode", mode, "--out", mode], 0);
        let metrics = metrics(&path.join(mode));
        assert_eq!(metrics["mode"], mode);
        assert_eq!(metrics["frames"], 6);
        assert_eq!(metrics["frames_damaged"], 0);
    }
}

#[test]
fn json_lines_for_machines() {
    let folder = folder_with_recording();
    let output = run(
        folder.path(),
        &["run", "room", "--json", "--frames", "..4"],
        0,
    );
    let text = stdout(&output);
    let events: Vec<Value> = text
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let kinds: Vec<_> = events
        .iter()
        .map(|event| event["event"].as_str().unwrap())
        .collect();
    assert_eq!(
        kinds,
        ["start", "frame", "frame", "frame", "frame", "metrics"]
    );
    assert!(events[0]["backend"].is_string());
    assert_eq!(events[0]["backend"], events[5]["backend"]);
    assert_eq!(events[2]["index"], 1);
    assert_eq!(events[5]["frames"], 4);
    assert_eq!(stderr(&output), "");
    let output = run(folder.path(), &["eval", "runs/room", "--json"], 0);
    let last: Value = serde_json::from_str(stdout(&output).trim()).unwrap();
    assert!(last["psnr_db"].is_number());
}

#[test]
fn a_damaged_frame_is_skipped_counted_and_reported() {
    let folder = folder_with_recording();
    let path = folder.path();
    let [color, _] = frame_files(&path.join("room"), 6);
    let bytes = fs::read(&color).unwrap();
    fs::write(&color, &bytes[..bytes.len() / 2]).unwrap();
    let output = run(path, &["run", "room", "--eval"], 0);
    let message = stderr(&output);
    assert!(
        message.starts_with("warning: frame 6 is skipped: "),
        "{message}"
    );
    assert!(
        message.contains(color.file_name().unwrap().to_str().unwrap()),
        "{message}"
    );
    let run = path.join("runs/room");
    let metrics = metrics(&run);
    assert_eq!(
        (&metrics["frames"], &metrics["frames_damaged"]),
        (&12.into(), &1.into())
    );
    assert_strict_trajectory(&run, FRAMES - 1);
    let rows = rows(&run);
    let damaged: Vec<_> = rows
        .iter()
        .filter(|row| row["status"] == "damaged")
        .collect();
    assert_eq!(damaged.len(), 1);
    assert_eq!(damaged[0]["index"], "6");
    assert_eq!(damaged[0]["psnr_db"], "");
    assert!(
        rows.iter()
            .all(|row| (row["psnr_db"].is_empty()) == (row["status"] != "tracked"))
    );
}

#[test]
fn a_covered_lens_is_lost_not_invented() {
    let folder = folder_with_recording();
    let path = folder.path();
    for index in 5..8 {
        let [color, depth] = frame_files(&path.join("room"), index);
        image::RgbImage::new(160, 120).save(color).unwrap();
        image::ImageBuffer::<image::Luma<u16>, Vec<u16>>::new(160, 120)
            .save(depth)
            .unwrap();
    }
    run(path, &["run", "room"], 0);
    let run = path.join("runs/room");
    let lost: Vec<usize> = rows(&run)
        .iter()
        .filter(|row| row["status"] == "lost")
        .map(|row| row["index"].parse().unwrap())
        .collect();
    assert_eq!(lost, [5, 6, 7]);
    assert_eq!(metrics(&run)["frames_lost"], 3);
    assert_strict_trajectory(&run, FRAMES - 3);
}

#[test]
fn a_run_that_never_sees_anything_says_so() {
    let folder = folder_with_recording();
    let path = folder.path();
    for index in 0..FRAMES {
        let [_, depth] = frame_files(&path.join("room"), index);
        image::ImageBuffer::<image::Luma<u16>, Vec<u16>>::new(160, 120)
            .save(depth)
            .unwrap();
    }
    let message = stderr(&run(path, &["run", "room", "--eval"], 1));
    for part in ["lost in every frame", "no surface", "fgs doctor room"] {
        assert!(message.contains(part), "{message}");
    }
    let message = stderr(&run(path, &["render", "runs/room"], 1));
    assert!(message.contains("no poses"), "{message}");
    let poses = ["--trajectory", "room/groundtruth.txt"];
    let message = stderr(&run(
        path,
        &[&["render", "runs/room"], poses.as_slice()].concat(),
        1,
    ));
    assert!(message.contains("is empty"), "{message}");
    let run = path.join("runs/room");
    assert_strict_trajectory(&run, 0);
    let metrics = metrics(&run);
    assert_eq!(metrics["frames_lost"], FRAMES);
    assert_eq!(metrics["psnr_db"], Value::Null);
    assert_eq!(metrics["ate_rmse_m"], Value::Null);
}

/// With refinement and test views: both maps repeat, and both are scored again.
#[test]
fn refined_runs_repeat_and_can_be_scored() {
    let folder = folder_with_recording();
    let path = folder.path();
    run(
        path,
        &["run", "room", "--backend", "cpu", "--out", "plain"],
        0,
    );
    let more = ["--refine", "30", "--eval-holdout", "4", "--backend", "cpu"];
    let run_on = |threads: &str, rest: &[&str]| {
        let room = ["run", "room", "--threads", threads];
        run(path, &[&room, more.as_slice(), rest].concat(), 0)
    };
    let output = run_on("1", &["--eval"]);
    let table = stdout(&output);
    assert!(
        table.contains("\n  refined    30 more steps in "),
        "{table}"
    );
    for line in ["PSNR      ", "SSIM      ", "test views"] {
        for indent in ["  ", "    "] {
            assert!(
                table.contains(&format!("\n{indent}{line} ")),
                "{line}: {table}"
            );
        }
    }
    run_on("2", &[]);
    let (first, second) = (path.join("runs/room"), path.join("runs/room-2"));
    assert_same_bytes(&first, &second);
    let refined_map = |run: &Path| fs::read(run.join("refined.ply")).unwrap();
    assert!(refined_map(&first) == refined_map(&second));
    assert!(refined_map(&first) != fs::read(first.join("map.ply")).unwrap());
    for (index, row) in rows(&first).iter().enumerate() {
        assert!(index % 4 != 3 || row["keyframe"].is_empty(), "{row:?}");
    }

    run(path, &["eval", "runs/room-2"], 0);
    let (scored, evaluated) = (metrics(&first), metrics(&second));
    let keys = [
        "psnr_db",
        "ssim",
        "psnr_heldout_db",
        "test_psnr_db",
        "test_ssim",
    ];
    for key in keys {
        for of in [
            |metrics: &Value| metrics.clone(),
            |metrics: &Value| metrics["refined"].clone(),
        ] {
            let (before, again) = (
                of(&scored)[key].as_f64().unwrap(),
                of(&evaluated)[key].as_f64().unwrap(),
            );
            assert!(
                (again - before).abs() <= 1e-9 * before,
                "{key}: {again} {before}"
            );
        }
    }
    assert_eq!(scored["refined"]["steps"], 30);
    assert_eq!(scored["eval_holdout"], 4);

    let config = [
        "--config",
        "runs/room/config.effective.toml",
        "--out",
        "again",
    ];
    run(path, &[&["run", "room"], config.as_slice()].concat(), 0);
    assert!(refined_map(&first) == refined_map(&path.join("again")));
    run(
        path,
        &["render", "runs/room/refined.ply", "--views", "1"],
        0,
    );

    // Where neither is asked for, nothing tells of it.
    let plain = path.join("plain");
    assert_eq!(names(&plain), FILES);
    for file in ["metrics.json", "config.effective.toml"] {
        let text = fs::read_to_string(plain.join(file)).unwrap();
        for word in ["refine =", "refined", "holdout", "test_"] {
            assert!(!text.contains(word), "{word} is in\n{text}");
        }
    }
}

/// Runs the room until an event and then presses Ctrl-C.
#[cfg(unix)]
fn interrupt(path: &Path, arguments: &[&str], event: &str) {
    let command = fgs(path, &[&["run", "room", "--json"], arguments].concat());
    let (mut child, lines) = interrupt_at(event, command);
    let last = lines.last().unwrap().unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert!(last.contains(r#""event":"metrics""#), "{last}");
}

#[cfg(unix)]
#[test]
fn interrupted_runs_are_saved() {
    let folder = folder_with_recording();
    let path = folder.path();
    let slow = ["--set", "mapping.iterations_per_frame=50", "--eval"];
    interrupt(path, &slow, r#""event":"frame""#);
    let run = path.join("runs/room");
    assert_eq!(names(&run), FILES);
    let metrics = metrics(&run);
    assert_eq!(metrics["interrupted"], true);
    let frames = metrics["frames"].as_u64().unwrap() as usize;
    assert!((1..FRAMES).contains(&frames), "{frames}");
    assert_strict_trajectory(&run, frames);
}

#[cfg(unix)]
#[test]
fn runs_interrupted_while_they_are_refined_are_saved() {
    let folder = folder_with_recording();
    let path = folder.path();
    let endless = ["--refine", "1000000", "--eval"];
    interrupt(path, &endless, r#""event":"refinement""#);
    let run = path.join("runs/room");
    let metrics = metrics(&run);
    assert_eq!(metrics["interrupted"], true);
    assert_strict_trajectory(&run, FRAMES);
    let steps = metrics["refined"]["steps"].as_u64().unwrap();
    assert!((1..1_000_000).contains(&steps), "{steps}");
    for map in ["map.ply", "refined.ply"] {
        assert!(names(&run).contains(&map.into()), "{map}");
    }
}
