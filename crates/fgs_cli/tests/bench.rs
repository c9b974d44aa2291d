//! `fgs bench --backend gpu` on a tiny scene. Skipped where there is no graphics device.

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
    assert_eq!(rows.last().unwrap()["stage"], "whole step");
    let has_clock = !scene["entries"].is_null();
    assert!(rows.len() > 10 || !has_clock);
    for row in rows {
        assert!(row["median_ms"].as_f64().unwrap() >= row["best_ms"].as_f64().unwrap());
        assert_eq!(row["floor_ms"].is_f64(), has_clock, "{row}");
    }
}
