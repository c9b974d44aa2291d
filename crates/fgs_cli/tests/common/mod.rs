//! Runs the built program on tiny synthetic recordings.

#![allow(dead_code, reason = "each test program uses its own part of this")]

use std::fs;
use std::io::{BufRead, BufReader, Lines};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Output, Stdio};

use serde_json::Value;
use tempfile::TempDir;

pub const FRAMES: usize = 12;

/// The program, to be run in a folder.
pub fn fgs(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_fgs"));
    command.current_dir(folder).args(arguments);
    command
}

/// The program under a shell's limits, to be run in a folder; on Unix.
pub fn limited(folder: &Path, limits: &str, arguments: &str) -> Command {
    let script = format!("{limits}; exec \"$0\" {arguments}");
    let mut shell = Command::new("sh");
    shell
        .current_dir(folder)
        .args(["-c", &script, env!("CARGO_BIN_EXE_fgs")]);
    shell
}

/// Starts the program and presses Ctrl-C when it writes a line that contains an event; with what it
/// writes from there on; on Unix.
pub fn interrupt_at(event: &str, mut command: Command) -> (Child, Lines<BufReader<ChildStdout>>) {
    let mut child = command
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    assert!(lines.any(|line| line.unwrap().contains(event)));
    let pid = child.id().to_string();
    assert!(
        Command::new("kill")
            .args(["-INT", &pid])
            .status()
            .unwrap()
            .success()
    );
    (child, lines)
}

/// Runs the program and expects an exit code.
pub fn run(folder: &Path, arguments: &[&str], exit_code: i32) -> Output {
    let output = fgs(folder, arguments).output().unwrap();
    let stderr = stderr(&output);
    assert_eq!(
        output.status.code(),
        Some(exit_code),
        "{arguments:?}: {stderr}"
    );
    output
}

pub fn stderr(output: &Output) -> String {
    text(&output.stderr)
}

pub fn stdout(output: &Output) -> String {
    text(&output.stdout)
}

/// With the separators of Unix in paths.
fn text(bytes: &[u8]) -> String {
    let text = String::from_utf8(bytes.to_vec()).unwrap();
    if cfg!(windows) {
        text.replace('\\', "/")
    } else {
        text
    }
}

/// A folder with a recording `room` of 12 frames of 160x120 without noise.
pub fn folder_with_recording() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let frames = FRAMES.to_string();
    let size = ["--frames", &frames, "--size", "160x120", "--noise", "none"];
    run(
        folder.path(),
        &[&["synth", "room"], size.as_slice()].concat(),
        0,
    );
    folder
}

pub fn metrics(run: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(run.join("metrics.json")).unwrap()).unwrap()
}

/// The rows of `frames.csv`: a map from column to text each.
pub fn rows(run: &Path) -> Vec<std::collections::HashMap<String, String>> {
    let mut csv = csv::Reader::from_path(run.join("frames.csv")).unwrap();
    csv.deserialize().collect::<Result<_, _>>().unwrap()
}

/// The file names in a folder, sorted; none if there is no such folder.
pub fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten();
    let mut names: Vec<_> = entries
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        // Only Unix lets locks be removed by their holders.
        .filter(|name| cfg!(unix) || !name.ends_with(".lock"))
        .collect();
    names.sort();
    names
}

/// Colour and depth file of a frame of a recording in TUM's layout.
pub fn frame_files(recording: &Path, index: usize) -> [PathBuf; 2] {
    ["rgb", "depth"].map(|kind| {
        let folder = recording.join(kind);
        folder.join(&names(&folder)[index])
    })
}
