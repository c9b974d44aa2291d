//! `fgs export`: every format is written, says what it holds, and nothing else is overwritten.

#![allow(clippy::unwrap_used, reason = "a test may panic, its helpers too")]

mod common;

use std::fs;
use std::path::Path;

use common::{FRAMES, folder_with_recording, metrics, names, run, stderr, stdout};

const RUN: [&str; 5] = ["run", "room", "--backend", "cpu", "--threads"];

fn export(folder: &Path, arguments: &[&str]) -> String {
    stdout(&run(
        folder,
        &[&["export", "runs/room"], arguments].concat(),
        0,
    ))
}

fn refuse(folder: &Path, arguments: &[&str], exit_code: i32, part: &str) {
    let message = stderr(&run(folder, &[&["export"], arguments].concat(), exit_code));
    assert!(message.contains(part), "{arguments:?}: {message}");
}

#[test]
fn every_format() {
    let folder = folder_with_recording();
    let path = folder.path();
    run(
        path,
        &[&RUN, ["2", "--refine", "20"].as_slice()].concat(),
        0,
    );
    let exports = path.join("runs/room/export");
    let metrics = metrics(&path.join("runs/room"));
    let gaussians = &metrics["refined"]["num_gaussians"];
    let keyframes = &metrics["keyframes"];

    let down = "axes: level, x right, y down; the first camera looks over z; metres\n";
    let up = "axes: level, x right, y up; the first camera looks over -z; metres\n";
    for (format, name, axes) in [
        ("ply", "map.ply", down),
        ("compressed-ply", "map.compressed.ply", down),
        ("splat", "map.splat", down),
        ("spz", "map.spz", up),
        ("glb", "map.glb", up),
    ] {
        // The second time the file is replaced.
        for _ in 0..2 {
            assert_eq!(
                export(path, &["--to", format]),
                format!("runs/room/export/{name}: {gaussians} gaussians\n{axes}")
            );
        }
    }
    // The refined map, level and not.
    let level = fgs_splat::read_ply(&exports.join("map.ply")).unwrap();
    let text = export(path, &["--to", "ply", "--raw-axes"]);
    assert!(text.contains("axes: x right, y down, z forward from the first camera; metres"));
    let map = fgs_splat::read_ply(&exports.join("map.ply")).unwrap();
    assert_ne!(level.means, map.means);
    assert_eq!(level.log_scales, map.log_scales);
    let refined = fgs_splat::read_ply(&path.join("runs/room/refined.ply")).unwrap();
    assert_eq!(map.means, refined.means);
    assert_eq!(map.opacity_logits, refined.opacity_logits);
    let splats = fs::metadata(exports.join("map.splat")).unwrap().len();
    assert_eq!(splats, 32 * map.len() as u64);

    for (format, name, what, axes) in [
        ("points", "points.ply", " points\n", down),
        ("mesh-ply", "mesh.ply", " triangles\n", down),
        ("mesh-obj", "mesh.obj", " triangles\n", down),
        ("mesh-glb", "mesh.glb", " triangles\n", up),
    ] {
        let text = export(path, &["--to", format, "--voxel-m", "0.05"]);
        assert!(
            text.starts_with(&format!("runs/room/export/{name}: ")),
            "{text}"
        );
        assert!(text.ends_with(&format!("{what}{axes}")), "{text}");
        assert!(!text.contains(": 0 "), "{text}");
        assert!(exports.join(name).is_file());
    }

    let own = "axes: x right, y down, z forward from the first camera; metres\n";
    let poses = format!("{FRAMES} poses, 0 frames without one left out\n{own}");
    for (format, name) in [
        ("tum", "trajectory.tum.txt"),
        ("kitti", "trajectory.kitti.txt"),
    ] {
        let text = export(path, &["--to", format, "--raw-axes"]);
        assert_eq!(text, format!("runs/room/export/{name}: {poses}"));
    }
    // Quaternions are normalised when they are read, which may change their last digits.
    let numbers = |path: &Path| -> Vec<f64> {
        let text = fs::read_to_string(path).unwrap();
        let words = text.lines().filter(|line| !line.starts_with('#'));
        let words = words.flat_map(|line| line.split_whitespace().map(str::to_owned));
        words.map(|word| word.parse().unwrap()).collect()
    };
    let exported = numbers(&exports.join("trajectory.tum.txt"));
    let recorded = numbers(&path.join("runs/room/trajectory.txt"));
    assert_eq!((exported.len(), recorded.len()), (8 * FRAMES, 8 * FRAMES));
    for (exported, recorded) in exported.iter().zip(&recorded) {
        assert!(
            (exported - recorded).abs() <= 1e-12,
            "{exported} {recorded}"
        );
    }
    let kitti = fs::read_to_string(exports.join("trajectory.kitti.txt")).unwrap();
    assert_eq!(kitti.lines().count(), FRAMES);

    for format in ["colmap", "nerfstudio"] {
        let text = export(path, &["--to", format]);
        let start = format!("runs/room/export/{format}: {keyframes} images, ");
        assert!(text.starts_with(&start), "{text}");
        let images = names(&exports.join(format).join("images"));
        assert_eq!(images.len() as u64, keyframes.as_u64().unwrap());
        assert_eq!(images[0], "000000.png");
    }
}

#[test]
fn what_is_there_stays() {
    let folder = folder_with_recording();
    let path = folder.path();
    run(path, &[&RUN, ["2"].as_slice()].concat(), 0);
    let map = path.join("runs/room/map.ply");
    let before = fs::read(&map).unwrap();
    let to_own = ["runs/room", "--to", "ply", "--out", "runs/room/map.ply"];
    refuse(path, &to_own, 2, "runs/room/map.ply belongs to the run");
    assert!(fs::read(&map).unwrap() == before);

    // Exports are known as ours: the next run replaces them with the rest, but nothing else.
    let run_again = ["--out", "runs/room"];
    let again = |exit_code| {
        run(
            path,
            &[&RUN, ["2"].as_slice(), &run_again].concat(),
            exit_code,
        )
    };
    for format in ["splat", "colmap", "spz"] {
        export(path, &["--to", format]);
    }
    refuse(
        path,
        &["runs/room", "--to", "colmap"],
        1,
        "runs/room/export/colmap exists already",
    );
    let exports = path.join("runs/room/export");
    assert_eq!(
        names(&exports),
        [".fgs-files", "colmap", "map.splat", "map.spz"]
    );
    fs::write(exports.join("notes.txt"), "mine").unwrap();
    export(path, &["--to", "splat"]);
    assert!(stderr(&again(2)).contains("notes.txt"));
    assert_eq!(fs::read(exports.join("notes.txt")).unwrap(), b"mine");
    fs::remove_file(exports.join("notes.txt")).unwrap();
    // An export's name alone does not make it ours.
    fs::write(exports.join("mesh.obj"), "mine").unwrap();
    refuse(
        path,
        &["runs/room", "--to", "mesh-obj", "--voxel-m", "0.05"],
        2,
        "mesh.obj",
    );
    assert_eq!(fs::read(exports.join("mesh.obj")).unwrap(), b"mine");
    fs::remove_file(exports.join("mesh.obj")).unwrap();
    again(0);
    assert!(!exports.exists());
    assert_eq!(names(&path.join("runs")), ["room"]);

    // A folder, even an empty one, is not replaced; a recording that has moved is asked for.
    fs::create_dir(path.join("set")).unwrap();
    let to_set = ["runs/room", "--to", "colmap", "--out", "set"];
    refuse(path, &to_set, 1, "set exists already");
    let to_folder = ["runs/room", "--to", "splat", "--out", "set"];
    refuse(path, &to_folder, 1, "set");
    assert_eq!(names(&path.join("set")), [""; 0]);
    fs::rename(path.join("room"), path.join("moved")).unwrap();
    let to_set = ["runs/room", "--to", "nerfstudio", "--out", "a/new"];
    refuse(path, &to_set, 2, "--dataset DIR");
    run(
        path,
        &[&["export"], to_set.as_slice(), &["--dataset", "moved"]].concat(),
        0,
    );
    assert!(path.join("a/new/transforms.json").is_file());

    refuse(
        path,
        &["moved", "--to", "ply"],
        2,
        "moved is not the folder of a run",
    );
    refuse(
        path,
        &["runs/room", "--to", "mesh-ply", "--voxel-m", "0"],
        2,
        "0.001 to 1 m",
    );
}

/// Exports, pages and maps alone go by the direction that was found once.
#[test]
fn whatever_is_made_of_a_run_is_level_alike() {
    let folder = folder_with_recording();
    let path = folder.path();
    run(path, &[&RUN, ["2"].as_slice()].concat(), 0);
    let saved = path.join("runs/room/up.txt");
    let found: Vec<f64> = fs::read_to_string(&saved)
        .unwrap()
        .split_whitespace()
        .map(|word| word.parse().unwrap())
        .collect();
    let up_of_pages = |source: &str| -> Vec<f64> {
        run(path, &["view", source, "--export", "pages"], 0);
        let scene = fs::read(path.join("pages/scene.json")).unwrap();
        let scene: serde_json::Value = serde_json::from_slice(&scene).unwrap();
        serde_json::from_value(scene["up"].clone()).unwrap()
    };
    let is_close = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
    // It is the one that anybody finds who looks at the map.
    fs::remove_file(&saved).unwrap();
    assert!(is_close(&up_of_pages("runs/room"), &found));
    // Whatever it says is believed.
    let other = [0.6, -0.8, 0.0];
    assert!(!is_close(&found, &other));
    fs::write(&saved, "0.6 -0.8 0.0\n").unwrap();
    for source in ["runs/room", "runs/room/map.ply"] {
        assert!(is_close(&up_of_pages(source), &other), "{source}");
    }
    export(path, &["--to", "ply"]);
    let read = |name: &str| fgs_splat::read_ply(&path.join("runs/room").join(name)).unwrap();
    let (level, map) = (read("export/map.ply"), read("map.ply"));
    for (level, mean) in level.means.iter().zip(&map.means) {
        let height: f64 = (mean.iter().zip(other))
            .map(|(x, up)| f64::from(*x) * up)
            .sum();
        assert!((f64::from(level[1]) + height).abs() < 1e-4);
    }
}
