//! Two maps merged from the command line.

#![allow(clippy::unwrap_used, reason = "a test may panic, its helpers too")]

mod common;

use std::fs;
use std::path::Path;

use common::{names, rows, run, stderr};

fn map_of_part(path: &Path, room: &str, frames: &str, out: &str) {
    let what = ["run", room, "--frames", frames, "--out", out];
    let how = ["--backend", "cpu", "--checkpoint-every", "9"];
    let quick = ["--set", "mapping.iterations_per_frame=0.3"];
    run(path, &[&what[..], &how, &quick].concat(), 0);
}

#[test]
fn two_maps_become_one_that_a_run_finds_itself_in() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    for (name, seed) in [("room", "1"), ("other", "2")] {
        let what = ["synth", name, "--seed", seed, "--frames", "90"];
        let how = ["--size", "160x120", "--noise", "none"];
        run(path, &[&what[..], &how].concat(), 0);
    }
    map_of_part(path, "room", "..40", "a");
    map_of_part(path, "room", "20..", "b");
    map_of_part(path, "room", "..90", "whole");
    map_of_part(path, "other", "..12", "c");
    let read = |folder: &str| {
        let names = names(&path.join(folder));
        let files = names.iter().map(|name| path.join(folder).join(name));
        files
            .map(|file| fs::read(file).unwrap())
            .collect::<Vec<_>>()
    };
    let before = read("a.map");

    let merge = ["merge", "a", "b.map", "--out", "both", "--refine", "3"];
    run(path, &[&merge[..], &["--backend", "cpu"]].concat(), 0);
    assert!(read("a.map") == before);
    // What both show is there once, as if one run had seen all of it.
    let [a, b, whole, both] = ["a", "b", "whole", "both"].map(|name| {
        let map = path.join(name).join("map.ply");
        fgs_splat::read_ply(&map).unwrap().len() as f64
    });
    println!("{a} and {b} gaussians become {both}; one run has {whole}");
    assert!((0.9..1.1).contains(&(both / whole)) && both < 0.9 * (a + b));
    // The axes are the first's, and so is what is up.
    let up = |name: &str| fs::read_to_string(path.join(name).join("up.txt")).unwrap();
    assert_eq!(up("both"), up("a"));
    // Where only b has been.
    let last = ["run", "room", "--frames", "80..", "--map", "both"];
    let only = ["--localize-only", "--backend", "cpu", "--out", "found"];
    run(path, &[&last[..], &only].concat(), 0);
    let tracked = |row: &std::collections::HashMap<String, String>| row["status"] == "tracked";
    assert!(rows(&path.join("found"))[3..].iter().all(tracked));

    let refuse = |arguments: &[&str], exit_code: i32, part: &str| {
        let message = stderr(&run(path, arguments, exit_code));
        assert!(message.contains(part), "{message}");
    };
    refuse(&["merge", "a", "c", "--out", "no"], 1, "meet nowhere");
    refuse(
        &["merge", "a", "b", "--out", "b"],
        2,
        "choose another folder",
    );
    refuse(&["merge", "a", "room", "--out", "no"], 2, "holds no map");
    assert!(!path.join("no").exists() && !path.join("no.map").exists());
}
