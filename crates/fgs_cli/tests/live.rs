//! A run at work and a finished map, as a browser sees them.

#![allow(clippy::unwrap_used, reason = "a test may panic, its helpers too")]

mod common;

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Stdio};

use common::{FRAMES, fgs, folder_with_recording, names, run, stderr};
use serde_json::Value;

/// Starts a program that serves a page, and reads its output up to the address.
fn started(folder: &std::path::Path, arguments: &[&str]) -> (Child, String) {
    let mut child = fgs(folder, arguments)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let address = lines.find_map(|line| {
        let line = line.unwrap();
        let start = line.find("127.0.0.1:")?;
        Some(line[start..].split('/').next().unwrap().to_owned())
    });
    // Somebody must read the rest.
    std::thread::spawn(move || lines.for_each(drop));
    (child, address.unwrap())
}

fn ask(address: &str, request: &str) -> Vec<u8> {
    let mut stream = TcpStream::connect(address).unwrap();
    write!(stream, "{request} HTTP/1.1\r\nHost: {address}\r\n\r\n").unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    answer
}

fn body(answer: &[u8]) -> &[u8] {
    let end = answer
        .windows(4)
        .position(|bytes| bytes == b"\r\n\r\n")
        .unwrap();
    &answer[end + 4..]
}

#[test]
fn a_run_is_watched_from_its_beginning_to_its_end() {
    let folder = folder_with_recording();
    let arguments = [
        "run",
        "room",
        "--out",
        "out",
        "--json",
        "--live",
        "127.0.0.1:0",
    ];
    let (mut child, address) = started(folder.path(), &arguments);
    assert!(body(&ask(&address, "GET /")).starts_with(b"<!doctype html>"));
    let scene: Value = serde_json::from_slice(body(&ask(&address, "GET /scene.json"))).unwrap();
    assert_eq!(
        (&scene["live"], &scene["title"]),
        (&true.into(), &"room".into())
    );
    let answer = ask(&address, "GET /stream");
    let (mut rest, mut news, mut map, mut kinds) =
        (body(&answer), Vec::new(), Vec::new(), Vec::new());
    while let Some((head, after)) = rest.split_at_checked(5) {
        let length = u32::from_le_bytes(head[..4].try_into().unwrap()) as usize;
        let (content, after) = after.split_at(length);
        kinds.push(head[4]);
        match head[4] {
            1 => news.push(serde_json::from_slice::<Value>(content).unwrap()),
            2 => {
                let number =
                    |at: usize| u32::from_le_bytes(content[at..at + 4].try_into().unwrap());
                map.resize(32 * number(0) as usize, 0);
                let start = 32 * number(4) as usize;
                map[start..start + length - 8].copy_from_slice(&content[8..]);
            }
            _ => {}
        }
        rest = after;
    }
    assert!(child.wait().unwrap().success());
    assert_eq!(kinds.last(), Some(&5), "{kinds:?}");
    let frames: Vec<&Value> = news
        .iter()
        .flat_map(|news| news["frames"].as_array().unwrap())
        .collect();
    let indices: Vec<u64> = frames
        .iter()
        .map(|frame| frame["index"].as_u64().unwrap())
        .collect();
    assert_eq!(indices, (0..FRAMES as u64).collect::<Vec<u64>>());
    assert!(
        frames
            .iter()
            .all(|frame| frame["status"] == "tracked" && frame["position"].is_array())
    );
    let phases: Vec<&Value> = news.iter().map(|news| &news["phase"]["name"]).collect();
    assert_eq!(phases.last(), Some(&&Value::from("ended")));
    // Nobody's looking on changes the results.
    run(folder.path(), &["run", "room", "--out", "unwatched"], 0);
    for name in ["trajectory.txt", "map.ply"] {
        let [watched, unwatched] =
            ["out", "unwatched"].map(|run| fs::read(folder.path().join(run).join(name)).unwrap());
        assert!(watched == unwatched, "{name}");
    }
    // At the end the page shows the map that is saved, apart from the order.
    run(folder.path(), &["view", "out", "--export", "pages"], 0);
    let records = |map: &[u8]| {
        let mut records: Vec<[u8; 32]> = map.as_chunks().0.to_vec();
        records.sort_unstable();
        records
    };
    let saved = fs::read(folder.path().join("pages/map.splat")).unwrap();
    assert_eq!(records(&map), records(&saved));
}

#[test]
fn the_button_stops_a_run() {
    let folder = folder_with_recording();
    let arguments = [
        "run",
        "room",
        "--out",
        "out",
        "--live",
        "127.0.0.1:0",
        "--refine",
        "1000000",
    ];
    let (mut child, address) = started(folder.path(), &arguments);
    assert!(ask(&address, "POST /stop").starts_with(b"HTTP/1.1 202"));
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert!(folder.path().join("out/map.ply").is_file());
}

#[test]
fn a_finished_run_becomes_pages() {
    let folder = folder_with_recording();
    run(folder.path(), &["run", "room", "--out", "out"], 0);
    run(folder.path(), &["view", "out", "--export", "pages"], 0);
    let pages = folder.path().join("pages");
    let scene = fs::read_to_string(pages.join("scene.json")).unwrap();
    assert!(!scene.contains(folder.path().to_str().unwrap()));
    let scene: Value = serde_json::from_str(&scene).unwrap();
    assert_eq!(scene["path"].as_array().unwrap().len(), FRAMES);
    let map = fs::metadata(pages.join("map.splat")).unwrap();
    assert_eq!(map.len(), 32 * scene["gaussians"].as_u64().unwrap());
    let first = &scene["keyframes"][0];
    for picture in ["input", "render"] {
        let picture = fs::read(pages.join(first[picture].as_str().unwrap())).unwrap();
        assert!(picture.starts_with(&[0xff, 0xd8]));
    }
    let viewer = fs::read(pages.join("vendor/spark-three.min.js")).unwrap();
    assert!(
        !viewer.starts_with(&[0x1f, 0x8b]),
        "a web server would not say that it is packed"
    );
    // Nothing comes from elsewhere.
    for page in ["index.html", "style.css", "app.js", "space.js", "plots.js"] {
        let text = fs::read_to_string(pages.join(page)).unwrap();
        assert!(!text.contains("//cdn") && !text.contains("http"), "{page}");
    }
    let (mut child, address) = started(folder.path(), &["view", "out/map.ply", "--address", ":0"]);
    let scene: Value = serde_json::from_slice(body(&ask(&address, "GET /scene.json"))).unwrap();
    assert_eq!(scene["keyframes"], Value::Array(Vec::new()));
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn what_cannot_be_shown_is_refused() {
    let folder = folder_with_recording();
    let refused = |arguments: &[&str], exit_code: i32, part: &str| {
        let message = stderr(&run(folder.path(), arguments, exit_code));
        assert!(message.contains(part), "{message}");
    };
    refused(&["view", "room"], 2, "room");
    refused(&["view", "nothing.ply"], 1, "nothing.ply");
    refused(&["view", "nothing"], 1, "nothing");
    refused(&["run", "--live", "./room"], 2, "is not an address");
    refused(
        &["run", "room", "--live", "203.0.113.1:1"],
        1,
        "cannot listen at 203.0.113.1:1",
    );
    refused(
        &["demo", "--live", "203.0.113.1:1"],
        1,
        "cannot listen at 203.0.113.1:1",
    );
    assert_eq!(names(folder.path()), ["room"]);
}
