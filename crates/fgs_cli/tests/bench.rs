//! `fgs bench --backend gpu` on a tiny scene, skipped where there is no graphics device, and
//! `--robustness`.

#![allow(clippy::unwrap_used, reason = "a test may panic, its helpers too")]

mod common;

use common::{fgs, stderr, stdout};
use serde_json::Value;

#[test]
fn every_stage_of_a_step_has_a_time_and_a_floor() {
    let folder = tempfile::tempdir().unwrap();
    let size = ["--size", "64x48", "--gaussians", "200", "--json"];
    let arguments = [&["bench", "--backend", "gpu"], size.as_slice()].concat();
    let output = fgs(folder.path(), &arguments).output().unwrap();
    if output.status.code() == Some(2) {
        let message = stderr(&output);
        assert!(message.contains("no graphics device"), "{message}");
        eprintln!("skipped: {message}");
        return;
    }
    let text = stdout(&output);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let events: Vec<Value> = text
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let machine = &events[0];
    assert!(machine["bytes_per_sec"].as_f64().unwrap() > 0.0);
    assert!(machine["flops_per_sec"].as_f64().unwrap() > 0.0);
    let scene = events.last().unwrap();
    assert!(scene["device_bytes"].as_u64().unwrap() > 0);
    let rows: Vec<&Value> = events
        .iter()
        .filter(|event| event["event"] == "stage")
        .collect();
    let names: Vec<&str> = rows
        .iter()
        .map(|row| row["stage"].as_str().unwrap())
        .collect();
    for name in [
        "whole step, one view",
        "whole step",
        "keyframe: see through",
        "keyframe: insert 1 %",
        "keyframe: add view",
        "keyframe: covisibility",
        "prune nothing",
    ] {
        assert!(names.contains(&name), "{name} is not in {names:?}");
    }
    assert!(machine["dispatch_secs"].as_f64().unwrap() > 0.0);
    assert!(machine["indirect_dispatch_secs"].as_f64().unwrap() > 0.0);
    let has_clock = !scene["entries"].is_null();
    assert!(rows.len() > 15 || !has_clock);
    if has_clock {
        let number = |key: &str| scene[key].as_u64().unwrap();
        assert!((1..=200).contains(&number("longest_list")));
        assert!((1..=number("entries")).contains(&number("most_tiles")));
    }
    for row in rows {
        assert!(row["median_ms"].as_f64().unwrap() >= row["best_ms"].as_f64().unwrap());
        let of_step =
            !row["stage"].as_str().unwrap().contains("keyframe") && row["stage"] != "prune nothing";
        assert_eq!(row["floor_ms"].is_f64(), has_clock && of_step, "{row}");
    }
}

#[test]
fn robustness_judges_every_frame_of_the_scenarios_that_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = [
        "bench",
        "--robustness",
        "repeated",
        "--size",
        "160x120",
        "--json",
    ];
    let output = fgs(folder.path(), &arguments).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let events: Vec<Value> = stdout(&output)
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let scenario = &events[0];
    assert_eq!(scenario["scenario"], "repeated");
    assert_eq!(scenario["frames"], 42);
    assert_eq!(scenario["tracked"], 42);
    assert_eq!(scenario["wrong_tracked"], 0);
    assert_eq!(scenario["recovered_after"], 0);
    let worst_m = scenario["worst_tracked_m"].as_f64().unwrap();
    assert!(worst_m > 0.0 && worst_m < 0.02, "{worst_m}");
    let frames = events.iter().filter(|event| event["event"] == "frame");
    assert_eq!(frames.count(), 42);
    assert_eq!(events.len(), 43);
}
