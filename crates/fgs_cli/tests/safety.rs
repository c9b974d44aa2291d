//! Nothing of the user's is lost, nothing hangs, nothing is pretended.

#![allow(clippy::unwrap_used, reason = "a test may panic, its helpers too")]

mod common;

use std::fs;
use std::path::Path;
#[cfg(unix)]
use std::process::Command;
use std::process::{Output, Stdio};
#[cfg(unix)]
use std::time::{Duration, Instant};

use common::{fgs, folder_with_recording, metrics, names, rows, run, stderr, stdout};
#[cfg(unix)]
use common::{frame_files, interrupt_at, limited};

const RUN: [&str; 6] = ["run", "room", "--backend", "cpu", "--out", "out"];

/// Longer than anything here takes on a busy machine, shorter than for ever.
#[cfg(unix)]
const PATIENCE: Duration = Duration::from_secs(100);

fn run_with(folder: &Path, more: &[&str], exit_code: i32) -> Output {
    run(folder, &[&RUN, more].concat(), exit_code)
}

/// Waits for a program, which is ended if it takes too long.
#[cfg(unix)]
fn finish(mut command: Command) -> Output {
    let mut child = command
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let start = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if start.elapsed() > PATIENCE {
            child.kill().unwrap();
            panic!("{command:?} hangs");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    child.wait_with_output().unwrap()
}

/// Expects one line on stderr with all of these in it.
fn assert_says(output: &Output, exit_code: i32, parts: &[&str]) {
    let message = stderr(output);
    assert_eq!(output.status.code(), Some(exit_code), "{message}");
    assert_eq!(message.trim_end().lines().count(), 1, "{message}");
    for part in parts {
        assert!(message.contains(part), "'{part}' is not in {message}");
    }
}

/// All files in a folder with their contents.
fn contents(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut all = Vec::new();
    for name in names(folder) {
        let path = folder.join(&name);
        if path.is_dir() {
            let inner = contents(&path).into_iter();
            all.extend(inner.map(|(inner, bytes)| (format!("{name}/{inner}"), bytes)));
        } else {
            all.push((name, fs::read(&path).unwrap()));
        }
    }
    all
}

fn only_out(folder: &Path) {
    assert_eq!(names(folder), ["out", "room"]);
}

#[test]
fn a_folder_that_holds_anything_of_the_users_is_left_alone() {
    let folder = folder_with_recording();
    let path = folder.path();
    fs::create_dir_all(path.join("out/pictures")).unwrap();
    fs::write(path.join("out/pictures/x.png"), "mine").unwrap();
    assert_says(
        &run_with(path, &["--frames", "..2"], 2),
        2,
        &["out holds", "x.png"],
    );
    assert_eq!(fs::read(path.join("out/pictures/x.png")).unwrap(), b"mine");
    fs::remove_dir_all(path.join("out")).unwrap();

    // A run's own results are replaced, also those that were rendered from it.
    run_with(path, &["--frames", "..2", "--refine", "3"], 0);
    run(path, &["render", "out", "--views", "2"], 0);
    run(path, &["render", "out", "--views", "1"], 0);
    assert_eq!(names(&path.join("out/views")), [".fgs-files", "000000.png"]);
    run_with(path, &["--frames", "..3"], 0);
    assert!(!path.join("out/refined.ply").exists() && !path.join("out/views").exists());
    assert_eq!(rows(&path.join("out")).len(), 3);

    // But not if there is more.
    fs::write(path.join("out/notes.txt"), "mine").unwrap();
    let before = contents(&path.join("out"));
    assert_says(&run_with(path, &["--frames", "..2"], 2), 2, &["notes.txt"]);
    assert!(contents(&path.join("out")) == before);
    // Pictures go nowhere near other files either.
    fs::create_dir(path.join("album")).unwrap();
    fs::write(path.join("album/000000.png"), "mine").unwrap();
    let render = run(
        path,
        &["render", "out", "--views", "1", "--out", "album"],
        2,
    );
    assert_says(&render, 2, &["album holds", "000000.png"]);
    // Scoring keeps it.
    run(path, &["eval", "out"], 0);
    assert_eq!(fs::read(path.join("out/notes.txt")).unwrap(), b"mine");
    assert_eq!(names(path), ["album", "out", "room"]);
}

#[test]
fn only_the_runs_recording_scores_it() {
    let folder = folder_with_recording();
    let path = folder.path();
    run_with(path, &["--frames", "..4"], 0);
    let before = contents(&path.join("out"));
    let synth = |name: &str, frames: &str, size: &str| {
        let options = ["--frames", frames, "--size", size, "--noise", "none"];
        run(path, &[&["synth", name], options.as_slice()].concat(), 0);
    };
    synth("shorter", "3", "160x120");
    synth("longer", "13", "160x120");
    synth("larger", "12", "168x126");
    for (other, part) in [
        ("shorter", "has 3 frames"),
        ("longer", "has 13 frames"),
        ("larger", "its camera is another"),
        ("absent", "absent"),
    ] {
        let output = run(path, &["eval", "out", "--dataset", other], 2);
        assert_says(&output, 2, &[other, part]);
        assert!(contents(&path.join("out")) == before, "{other}");
    }
    // The same room under another name.
    fs::rename(path.join("room"), path.join("moved")).unwrap();
    let output = run(path, &["eval", "out"], 2);
    assert_says(&output, 2, &["room", "--dataset DIR"]);
    run(path, &["eval", "out", "--dataset", "moved"], 0);
    // From anywhere.
    fs::rename(path.join("moved"), path.join("room")).unwrap();
    fs::create_dir(path.join("elsewhere")).unwrap();
    run(&path.join("elsewhere"), &["eval", "../out"], 0);
    assert_eq!(metrics(&path.join("out"))["dataset"], "../room");
}

#[test]
fn scores_are_of_this_evaluation_or_empty() {
    let folder = folder_with_recording();
    let path = folder.path();
    run_with(path, &["--frames", "..4", "--eval"], 0);
    let out = path.join("out");
    assert!(metrics(&out)["psnr_db"].is_number());
    // Planted scores, and no poses to score.
    let csv = fs::read_to_string(out.join("frames.csv")).unwrap();
    let planted: Vec<String> = csv
        .lines()
        .map(|line| match line.rsplitn(3, ',').last() {
            Some(rest) if !line.starts_with("index") => format!("{rest},18,0.1"),
            _ => line.to_owned(),
        })
        .collect();
    fs::write(out.join("frames.csv"), planted.join("\n")).unwrap();
    fs::write(out.join("trajectory.txt"), "# no poses\n").unwrap();
    run(path, &["eval", "out"], 0);
    let metrics = metrics(&out);
    for key in ["psnr_db", "ssim", "ate_rmse_m", "depth_l1_m"] {
        assert!(metrics[key].is_null(), "{key}: {metrics}");
    }
    assert!(rows(&out).iter().all(|row| row["ssim"].is_empty()));
    only_out(path);
}

#[cfg(unix)]
#[test]
fn nobody_reads_the_warnings() {
    let folder = folder_with_recording();
    let path = folder.path();
    let [color, _] = frame_files(&path.join("room"), 1);
    fs::write(color, "no picture").unwrap();
    for redirected in [
        "2>/dev/full",
        "2>&-",
        "2>&1 >/dev/null | true",
        ">/dev/full 2>&1",
    ] {
        if cfg!(not(target_os = "linux")) && redirected.contains("full") {
            continue;
        }
        let script = format!("\"$0\" run room --backend cpu --out out --frames ..4 {redirected}");
        let mut shell = Command::new("sh");
        shell
            .current_dir(path)
            .args(["-c", &script, env!("CARGO_BIN_EXE_fgs")]);
        finish(shell);
        assert_eq!(
            metrics(&path.join("out"))["frames_damaged"],
            1,
            "{redirected}"
        );
        fs::remove_dir_all(path.join("out")).unwrap();
    }
}

#[cfg(target_os = "linux")]
#[test]
fn names_that_are_not_utf_8() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;
    let folder = folder_with_recording();
    let path = folder.path();
    let odd = OsStr::from_bytes(b"r\xff\xfe");
    fs::rename(path.join("room"), path.join(odd)).unwrap();
    let mut command = fgs(
        path,
        &["run", "--frames", "..3", "--backend", "cpu", "--json"],
    );
    let output = finish({
        command.arg(odd);
        command
    });
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let out = path.join("runs").join(odd);
    assert_eq!(metrics(&out)["frames"], 3);
    let mut eval = fgs(path, &["eval"]);
    eval.arg(&out).arg("--dataset").arg(odd);
    let output = finish(eval);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    // Such a picture is named, not passed over.
    fs::remove_file(path.join(odd).join("rgb.txt")).unwrap();
    fs::remove_file(path.join(odd).join("depth.txt")).unwrap();
    fs::write(
        path.join(odd)
            .join("rgb")
            .join(OsStr::from_bytes(b"\xff.png")),
        "",
    )
    .unwrap();
    let mut command = fgs(path, &["run", "--backend", "cpu"]);
    command.arg(odd);
    assert_says(&finish(command), 2, &["not UTF-8", "\\xFF.png"]);
}

#[test]
fn counts_have_limits() {
    let folder = folder_with_recording();
    for key in [
        "tracking.grid_stride_px",
        "keyframes.mapping_every",
        "seeding.high_stride_px",
        "seeding.low_stride_px",
        "mapping.max_keyframes",
        "mapping.prune_every",
    ] {
        let set = format!("{key}=9223372036854775807");
        let output = run_with(folder.path(), &["--set", &set], 2);
        assert_says(&output, 2, &[&format!("--set {set}: "), "between 1 and"]);
    }
    for set in ["seeding.high_sigma_px=1e308", "seeding.low_sigma_px=1e308"] {
        assert_says(
            &run_with(folder.path(), &["--set", set], 2),
            2,
            &["= 1e308 is not"],
        );
    }
    assert_says(
        &run_with(folder.path(), &["--set", "seed=-1"], 2),
        2,
        &["seed=-1"],
    );
    run_with(folder.path(), &["--refine", "99999999999"], 2);
    assert_eq!(names(folder.path()), ["room"]);
}

#[test]
fn images_have_limits() {
    let folder = folder_with_recording();
    let path = folder.path();
    let synth = run(path, &["synth", "new", "--size", "65536x65536"], 2);
    assert!(stderr(&synth).contains("too large"), "{}", stderr(&synth));
    run_with(path, &["--frames", "..2"], 0);
    let render = run(path, &["render", "out", "--size", "65536x65536"], 2);
    assert!(stderr(&render).contains("too large"), "{}", stderr(&render));
}

/// As a whole this picture would take 0.6 GB.
#[cfg(target_os = "linux")]
#[test]
fn a_large_picture_is_rendered_in_bands() {
    let folder = folder_with_recording();
    let path = folder.path();
    run_with(path, &["--frames", "..2"], 0);
    let render = "render out --views 1 --threads 2 --size 5000x4000";
    let output = finish(limited(path, "ulimit -v 400000", render));
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let picture = image::image_dimensions(path.join("out/views/000000.png"));
    assert_eq!(picture.unwrap(), (5000, 4000));
}

/// Nothing is read that is no regular file, and nothing without end.
#[cfg(target_os = "linux")]
#[test]
fn what_is_no_file_is_named_and_does_not_hang() {
    use std::os::unix::fs::symlink;
    let folder = folder_with_recording();
    let path = folder.path();
    run_with(path, &["--frames", "..2"], 0);
    let fifo = |path: &Path| {
        let _ = fs::remove_file(path);
        assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
    };
    let zero = |path: &Path| {
        let _ = fs::remove_file(path);
        symlink("/dev/zero", path).unwrap();
    };
    let endless = run(path, &["run", "room", "--config", "/dev/zero"], 2);
    assert_says(&endless, 2, &["/dev/zero", "is a device"]);
    for (file, make, what) in [
        ("room/camera.toml", fifo as fn(&Path), "named pipe"),
        ("room/rgb.txt", fifo, "named pipe"),
        ("room/depth.txt", zero, "device"),
        ("room/groundtruth.txt", fifo, "named pipe"),
        ("out/metrics.json", zero, "device"),
        ("out/frames.csv", zero, "device"),
        ("out/map.ply", fifo, "named pipe"),
    ] {
        let (target, kept) = (path.join(file), path.join("kept"));
        fs::rename(&target, &kept).unwrap();
        make(&target);
        let commands: &[&[&str]] = if file.starts_with("room") {
            &[
                &[
                    "run",
                    "room",
                    "--backend",
                    "cpu",
                    "--frames",
                    "..1",
                    "--out",
                    "new",
                ],
                &["doctor", "room"],
            ]
        } else {
            &[&["eval", "out"]]
        };
        for command in commands {
            let output = finish(fgs(path, command));
            let message = stderr(&output) + &stdout(&output);
            assert!(
                message.contains(what) && message.contains(file),
                "{file}: {message}"
            );
        }
        fs::rename(&kept, &target).unwrap();
    }
    let [color, _] = frame_files(&path.join("room"), 1);
    fifo(&color);
    let output = finish(fgs(
        path,
        &[
            "run",
            "room",
            "--backend",
            "cpu",
            "--frames",
            "..3",
            "--out",
            "one",
        ],
    ));
    assert_says(&output, 1, &["rgb.txt:4", "named pipe"]);
}

#[cfg(unix)]
#[test]
fn a_stop_is_seen_within_a_frame() {
    let folder = folder_with_recording();
    let path = folder.path();
    for mode in ["lockstep", "parallel"] {
        let slow = [
            "--json",
            "--mode",
            mode,
            "--set",
            "mapping.iterations_per_frame=10000",
        ];
        let command = fgs(path, &[&RUN, slow.as_slice()].concat());
        // It may go on writing.
        let (mut child, _lines) = interrupt_at(r#""event":"frame""#, command);
        let start = Instant::now();
        while child.try_wait().unwrap().is_none() {
            if start.elapsed() > Duration::from_secs(20) {
                child.kill().unwrap();
                panic!("{mode}: still at work");
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        assert_eq!(child.wait().unwrap().code(), Some(130));
        assert_eq!(metrics(&path.join("out"))["interrupted"], true);
    }
    only_out(path);
}

#[test]
fn two_runs_at_once() {
    let folder = folder_with_recording();
    let path = folder.path();
    let start = |seed: &str, out: &[&str]| {
        let arguments = [
            "run",
            "room",
            "--backend",
            "cpu",
            "--frames",
            "..3",
            "--set",
            seed,
        ];
        let mut command = fgs(path, &[&arguments, out].concat());
        command
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap()
    };
    let runs = [
        start("seed=1", &["--out", "out"]),
        start("seed=2", &["--out", "out"]),
    ];
    let outputs = runs.map(|child| child.wait_with_output().unwrap());
    let codes = outputs
        .each_ref()
        .map(|output| output.status.code().unwrap());
    for output in &outputs {
        let message = stderr(output);
        assert!(
            message.is_empty() || message.contains("another fgs is writing to out"),
            "{message}"
        );
    }
    assert!(codes.contains(&0), "{codes:?}");
    assert_one_run(&path.join("out"));
    // Without a name each gets its own.
    let runs = [start("seed=1", &[]), start("seed=2", &[])];
    for child in runs {
        let output = child.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    }
    assert_eq!(names(&path.join("runs")), ["room", "room-2"]);
}

/// That every file is of the run that `metrics.json` tells of.
fn assert_one_run(out: &Path) {
    let metrics = metrics(out);
    let config = fs::read_to_string(out.join("config.effective.toml")).unwrap();
    let seed = format!("seed = {}", metrics["seed"]);
    assert!(config.lines().any(|line| line == seed), "{seed}: {config}");
    assert_eq!(rows(out).len() as u64, metrics["frames"].as_u64().unwrap());
    let map = fgs_splat::read_ply(&out.join("map.ply")).unwrap();
    assert_eq!(map.len() as u64, metrics["num_gaussians"].as_u64().unwrap());
    let bytes = fs::metadata(out.join("map.ply")).unwrap().len();
    assert_eq!(metrics["map_bytes"], bytes);
}

/// Killed at many moments while old results are replaced: they are whole, or the new ones are.
#[cfg(unix)]
#[test]
fn killed_while_replacing() {
    let folder = folder_with_recording();
    let path = folder.path();
    let kills: u64 = std::env::var("FGS_KILLS").map_or(6, |kills| kills.parse().unwrap());
    let out = path.join("out");
    let mut replaced = 0;
    run_with(path, &["--frames", "..2", "--set", "seed=1"], 0);
    let start = Instant::now();
    run_with(path, &["--frames", "..2", "--set", "seed=1"], 0);
    let whole = start.elapsed();
    for kill in 0..kills {
        let before = metrics(&out)["seed"].as_u64().unwrap();
        let seed = format!("seed={}", 2 + kill);
        let mut child = fgs(
            path,
            &[&RUN, ["--frames", "..2", "--set", &seed].as_slice()].concat(),
        )
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
        // The last half, where files are written.
        let share = 0.5 + 0.6 * kill as f64 / kills as f64;
        std::thread::sleep(whole.mul_f64(share));
        let _ = child.kill();
        child.wait().unwrap();
        assert_one_run(&out);
        let now = metrics(&out)["seed"].as_u64().unwrap();
        assert!(now == before || now == 2 + kill, "{before}, then {now}");
        replaced += u64::from(now != before);
    }
    if kills > 6 {
        assert!((1..kills).contains(&replaced), "{replaced} of {kills}");
    }
    run_with(path, &["--frames", "..2"], 0);
    only_out(path);
}

/// Another run in place of that of the first three frames.
#[cfg(unix)]
const AGAIN: &str = "run room --out out --frames ..3 --backend cpu --set seed=2";

/// Writing beyond so many blocks of a file fails.
#[cfg(unix)]
fn full_disk(blocks: u32) -> String {
    format!("trap '' XFSZ; ulimit -f {blocks}")
}

/// A file that grows beyond a limit ends the process at once, at the first that is so large.
#[cfg(unix)]
#[test]
fn killed_at_a_write() {
    let folder = folder_with_recording();
    let path = folder.path();
    run_with(path, &["--frames", "..3"], 0);
    let before = contents(&path.join("out"));
    for blocks in [0, 1, 2, 4, 16, 64] {
        let again = limited(path, &format!("ulimit -f {blocks}"), AGAIN);
        assert_eq!(finish(again).status.code(), None, "{blocks}");
        assert!(contents(&path.join("out")) == before, "{blocks}");
    }
    run_with(path, &["--frames", "..2"], 0);
    only_out(path);
}

/// Ever smaller limits on the size of a file stand in for a disk that is full at every write.
#[cfg(unix)]
#[test]
fn a_full_disk_at_every_write() {
    let folder = folder_with_recording();
    let path = folder.path();
    run_with(path, &["--frames", "..3"], 0);
    let before = contents(&path.join("out"));
    let mut failures = 0;
    for blocks in [0, 1, 2, 4, 8, 16, 32, 64, 128, 4096] {
        let output = finish(limited(path, &full_disk(blocks), AGAIN));
        let message = stderr(&output);
        if output.status.code() == Some(0) {
            assert_one_run(&path.join("out"));
            assert_eq!(metrics(&path.join("out"))["seed"], 2);
            continue;
        }
        failures += 1;
        assert_says(&output, 1, &["cannot write"]);
        // The old results are whole, what could be written of the new ones is beside them.
        assert!(contents(&path.join("out")) == before, "{blocks}: {message}");
        let left = names(&path.join("out-2"));
        assert!(
            blocks == 0 || left.contains(&"trajectory.txt".to_owned()),
            "{blocks}: {left:?}"
        );
        assert!(
            !left.iter().any(|name| name.ends_with(".unfinished")),
            "{left:?}"
        );
        let _ = fs::remove_dir_all(path.join("out-2"));
    }
    assert!(failures >= 4, "{failures}");
    only_out(path);
}

/// As [`a_full_disk_at_every_write`], of what works on a finished run.
#[cfg(unix)]
#[test]
fn a_full_disk_while_scoring_and_rendering() {
    let folder = folder_with_recording();
    let path = folder.path();
    run_with(path, &["--frames", "..3"], 0);
    run(path, &["render", "out", "--views", "2"], 0);
    let before = contents(&path.join("out"));
    let mut failures = 0;
    for command in [
        "eval out",
        "render out --views 3",
        "export out --to ply --out new/map.ply",
    ] {
        for blocks in [0, 1, 2, 8, 32] {
            let output = finish(limited(path, &full_disk(blocks), command));
            if output.status.code() == Some(0) {
                assert!(blocks > 1, "{command}");
                continue;
            }
            failures += 1;
            assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
            assert!(contents(&path.join("out")) == before, "{command}, {blocks}");
            assert!(names(&path.join("new")).is_empty(), "{command}, {blocks}");
        }
    }
    assert!(failures >= 8, "{failures}");
    let _ = fs::remove_dir(path.join("new"));
    only_out(path);
}

#[test]
fn what_is_mistyped_is_a_usage_error() {
    let folder = folder_with_recording();
    let path = folder.path();
    assert_says(&run(path, &["run", "rom"], 2), 2, &["rom does not exist"]);
    let file = "room/rgb.txt";
    assert_says(
        &run(path, &["run", file], 2),
        2,
        &[file, "holds no recording"],
    );
    #[cfg(unix)]
    for (link, target, what) in [
        ("round", "round", "is a link that leads round in a circle"),
        ("nowhere", "absent", "is a link that leads nowhere"),
    ] {
        std::os::unix::fs::symlink(target, path.join(link)).unwrap();
        assert_says(&run(path, &["run", link], 2), 2, &[link, what]);
        let config = ["run", "room", "--config", link];
        assert_says(&run(path, &config, 2), 2, &[link, what]);
    }
    let utf16 = |text: &str| -> Vec<u8> {
        let units = std::iter::once(0xfeff).chain(text.encode_utf16());
        units.flat_map(u16::to_le_bytes).collect()
    };
    fs::write(path.join("config.toml"), "seed = 3\n").unwrap();
    run_with(path, &["--frames", "..2"], 0);
    for (file, arguments) in [
        ("room/rgb.txt", ["run", "room"].as_slice()),
        ("room/camera.toml", &["run", "room"]),
        ("config.toml", &["run", "room", "--config", "config.toml"]),
        ("out/metrics.json", &["eval", "out"]),
        ("out/frames.csv", &["eval", "out"]),
        ("out/trajectory.txt", &["eval", "out"]),
        ("out/config.effective.toml", &["eval", "out"]),
    ] {
        let text = fs::read_to_string(path.join(file)).unwrap();
        fs::write(path.join(file), utf16(&text)).unwrap();
        assert_says(&run(path, arguments, 2), 2, &[file, "UTF-16"]);
        // With the mark of UTF-8 it is read as without.
        fs::write(path.join(file), format!("\u{feff}{text}")).unwrap();
        if file.starts_with("room") || file == "config.toml" {
            let short = ["--backend", "cpu", "--frames", "..1", "--out", "other"];
            run(path, &[arguments, &short].concat(), 0);
        } else {
            run(path, arguments, 0);
        }
    }
}

#[test]
fn no_names_of_types_and_no_endless_numbers() {
    let folder = folder_with_recording();
    let path = folder.path();
    for set in [
        "seed=1.5",
        "seed={a=1}",
        "mapping=3",
        "mapping.prune_every=-1",
        "tracking.max_depth_m=far",
        "run.mode=3",
        "run.dataset=3",
        "camera=3",
        "tracking.grid_stride_px=99999999999999999999",
        "mapping.iterations_per_frame=1e308",
    ] {
        let output = run_with(path, &["--set", set], 2);
        let message = stderr(&output);
        assert_says(&output, 2, &[set]);
        for word in [
            "usize",
            "u64",
            "f64",
            "i128",
            "struct",
            "variant",
            "string only",
            "00000000000000000000",
        ] {
            assert!(!message.contains(word), "{message}");
        }
    }
    run_with(path, &["--frames", "..2"], 0);
    let wide = run(path, &["render", "out", "--fov", "170"], 2);
    assert_says(&wide, 2, &["--fov 170", "160x120", "0.6 to 157.3 degrees"]);
}

#[test]
fn poses_that_cannot_be_used_are_left_out() {
    let folder = folder_with_recording();
    let path = folder.path();
    fs::write(path.join("room/groundtruth.txt"), "0 1 2 \u{1b}[31mred\n").unwrap();
    let output = run_with(path, &["--frames", "..3"], 0);
    assert_says(
        &output,
        0,
        &["warning", "poses are left out", "groundtruth.txt:1"],
    );
    assert!(!stderr(&output).contains('\u{1b}'));
    let metrics = metrics(&path.join("out"));
    assert!(metrics["ate_rmse_m"].is_null() && metrics["num_gaussians"] != 0);
    assert!(stdout(&run(path, &["doctor", "room"], 0)).contains("groundtruth.txt:1"));
}

/// Without its lists the recording is two folders of images.
#[test]
fn images_without_partners_are_named() {
    let folder = folder_with_recording();
    let path = folder.path();
    for kind in ["rgb", "depth"] {
        fs::remove_file(path.join("room").join(format!("{kind}.txt"))).unwrap();
        for (index, name) in names(&path.join("room").join(kind)).iter().enumerate() {
            let folder = path.join("room").join(kind);
            fs::rename(folder.join(name), folder.join(format!("{index:06}.png"))).unwrap();
        }
    }
    let _ = fs::remove_file(path.join("room/groundtruth.txt"));
    run_with(path, &["--frames", "..2"], 0);
    fs::remove_file(path.join("room/rgb/000005.png")).unwrap();
    let partner = "room/depth/000005.png has no partner";
    assert_says(&run_with(path, &[], 1), 1, &[partner, "room/rgb"]);
    // As many of both.
    fs::remove_file(path.join("room/depth/000007.png")).unwrap();
    assert_says(
        &run_with(path, &[], 1),
        1,
        &["room/rgb/000007.png has no partner"],
    );
    fs::remove_file(path.join("room/rgb/000007.png")).unwrap();
    fs::remove_file(path.join("room/depth/000005.png")).unwrap();
    run_with(path, &["--frames", "..2"], 0);
}
