//! The pages of a small run that was written by hand.

use std::fs;
use std::path::{Path, PathBuf};

use fgs_data::Trajectory;
use fgs_geom::{Image, Se3};
use fgs_slam::{FrameStatus, KeyframeKind};
use roxmltree::{Document, ParsingOptions};
use tempfile::TempDir;

use super::{RunData, comparison_page, page_of};
use crate::frame_log::{self, FrameRow};
use crate::pictures::write_png;
use crate::run_folder::{CONFIG, FRAMES, METRICS, PICTURES, REFERENCE, RunFolder, TRAJECTORY};
use crate::settings::Settings;

const FRAMES_RUN: usize = 20;
const HOSTILE: &str = "<script>alert(1)</script>&\"'";

const NUMBERS: &str = r#"
  "frames": 20, "frames_dropped": 0, "frames_lost": 4, "frames_weak": 1, "frames_damaged": 0,
  "interrupted": false, "ate_rmse_m": 0.0125, "psnr_valid_depth_db": 25.75, "psnr_db": 24.0, "lpips": null,
  "fps": 10.0, "tracking_ms": 20.0, "mapping_ms": 80.0, "iterations": 60, "iterations_per_frame": 10.0,
  "keyframes": 4, "loops": 7, "num_gaussians": 1000, "map_bytes": 68000, "peak_rss_bytes": null,
  "device_bytes": 0, "seed": 1, "commit": "0123abcd", "mode": "lockstep", "threads": 2"#;

/// A run whose files say `text` wherever they can say anything: 20 frames, 3 cm apart and half as much
/// off, of which four are lost.
fn run_folder(parent: &Path, name: &str, text: &str) -> PathBuf {
    let folder = parent.join(name);
    fs::create_dir_all(folder.join(PICTURES)).unwrap();
    let lost = |index| (8..12).contains(&index);
    let rows: Vec<_> = (0..FRAMES_RUN)
        .map(|index| {
            let mut row = FrameRow::new(index, FrameStatus::Tracked);
            row.timestamp_secs = Some(index as f64);
            if lost(index) {
                row.status = FrameStatus::Lost;
            } else {
                row.keyframe = (index % 5 == 0).then_some(KeyframeKind::Tracking);
                row.likeness = Some(0.9);
            }
            row.tracking_ms = Some(10.0 + index as f64);
            row
        })
        .collect();
    frame_log::write(&rows, fs::File::create(folder.join(FRAMES)).unwrap()).unwrap();
    let pose = |x: f64| Se3::from_wxyz([1.0, 0.0, 0.0, 0.0], [x, 0.0, 0.0]).unwrap();
    let frames = || (0..FRAMES_RUN).map(|index| (index, index as f64));
    let estimated = frames().filter(|(index, _)| !lost(*index));
    let estimated = estimated.map(|(_, secs)| (secs, pose(0.03 * secs)));
    let trajectory = Trajectory::new(estimated).unwrap();
    trajectory.write(&folder.join(TRAJECTORY)).unwrap();
    let reference = Trajectory::new(frames().map(|(_, secs)| (secs, pose(0.045 * secs)))).unwrap();
    reference.write(&folder.join(REFERENCE)).unwrap();
    let quoted = serde_json::to_string(text).unwrap();
    let path = serde_json::to_string(&format!("/home/somebody/{text}-room")).unwrap();
    let texts = format!(r#""failure": {quoted}, "backend": {quoted}, "dataset": {path}"#);
    fs::write(folder.join(METRICS), format!("{{{NUMBERS}, {texts}}}")).unwrap();
    let mut settings = Settings::load(None, &["seed=77".into()]).unwrap();
    settings.run.dataset = Some("/home/somebody/room".into());
    settings.run.command = Some("fgs run /home/somebody/room".into());
    fs::write(folder.join(CONFIG), settings.to_toml().unwrap()).unwrap();
    let picture = Image::from_fn(1000, 400, |u, _| [if u < 500 { 200 } else { 190 }, 0, 0]);
    let file = fs::File::create(folder.join(PICTURES).join("worst-frame-000003.png"));
    write_png(&picture, file.unwrap()).unwrap();
    fs::write(folder.join(PICTURES).join("frame-000001.png"), "no picture").unwrap();
    folder
}

fn page(folder: &RunFolder) -> String {
    page_of(&RunData::read(folder).unwrap(), folder.path().into()).unwrap()
}

fn report(text: &str) -> (TempDir, String) {
    let parent = tempfile::tempdir().unwrap();
    let folder = RunFolder::open(&run_folder(parent.path(), "desk", text)).unwrap();
    (parent, page(&folder))
}

/// Parses a page as XML, which is stricter than HTML, after `meta` is closed.
fn check(page: &str, look: impl FnOnce(&Document<'_>)) {
    let mut xml = page.replace("<!DOCTYPE html>", "");
    for (at, _) in page.rmatch_indices("<meta ") {
        let at = at - "<!DOCTYPE html>".len();
        let end = at + xml[at..].find('>').unwrap();
        xml.insert(end, '/');
    }
    let document = Document::parse_with_options(&xml, ParsingOptions::default()).unwrap();
    look(&document);
}

#[test]
fn a_page_shows_numbers_settings_plots_and_pictures() {
    let (_parent, page) = report("desk");
    check(&page, |document| {
        let count = |name: &str| {
            let nodes = document.descendants();
            nodes.filter(|node| node.tag_name().name() == name).count()
        };
        // Two views, verdicts, two kinds of keyframes; error, likeness and tracking time.
        assert_eq!(count("svg"), 2 + 1 + 2 + 3);
        assert_eq!(count("img"), 3);
        assert_eq!(count("script"), 0);
    });
    for part in [
        "25.75",
        "PSNR over the pixels with measured depth",
        "0123abcd",
        "7 loops",
        "<code>seed</code></td><td><code>77</code>",
        "desk-room",
        "lost (4)",
        "across frames that were lost",
        "data:image/jpeg;base64,",
    ] {
        assert!(page.contains(part), "{part}");
    }
    assert!(!page.contains("/home/"), "a path of the machine");
    assert!(!page.contains("frame-000001"), "what is no picture");
}

#[test]
fn texts_from_files_are_escaped() {
    let (parent, page) = report(HOSTILE);
    assert!(page.contains("&lt;script&gt;alert(1)"), "the text is there");
    let other = run_folder(parent.path(), "a&<b>", HOSTILE);
    let comparison = comparison_page(&[parent.path().join("desk"), other]).unwrap();
    for page in [page, comparison] {
        check(&page, |document| {
            let mut nodes = document.descendants();
            assert!(nodes.all(|node| !["script", "b"].contains(&node.tag_name().name())));
        });
    }
}

#[test]
fn a_comparison_has_a_column_for_each_run() {
    let parent = tempfile::tempdir().unwrap();
    let folders = ["first", "second", "third"].map(|name| run_folder(parent.path(), name, "x"));
    let settings = Settings::load(None, &["seed=78".into()]).unwrap();
    fs::write(folders[2].join(CONFIG), settings.to_toml().unwrap()).unwrap();
    let page = comparison_page(&folders).unwrap();
    let seeds =
        "<code>seed</code></td><td><code>77</code></td><td><code>77</code></td><td><code>78</code>";
    assert!(page.contains(seeds));
    assert_eq!(page.matches("0.01250").count(), 3);
    check(&page, |document| {
        let nodes = document.descendants();
        let svgs = nodes.filter(|node| node.tag_name().name() == "svg").count();
        assert_eq!(svgs, 2 + 3 + 3);
    });
    let nothing = comparison_page(&[parent.path()]).unwrap_err();
    assert!(nothing.to_string().contains("run"), "{nothing}");
}

/// Empty, constant and impossible numbers are no reason to fail.
#[test]
fn a_page_of_a_run_that_saw_nothing_can_be_made() {
    let parent = tempfile::tempdir().unwrap();
    let path = run_folder(parent.path(), "desk", "x");
    let folder = RunFolder::open(&path).unwrap();
    let mut huge = FrameRow::new(usize::MAX, FrameStatus::Tracked);
    huge.likeness = Some(1e300);
    huge.tracking_ms = Some(f64::NAN);
    for rows in [
        vec![],
        vec![FrameRow::new(3, FrameStatus::Damaged)],
        vec![huge],
    ] {
        frame_log::write(&rows, fs::File::create(path.join(FRAMES)).unwrap()).unwrap();
        let page = page(&folder);
        assert!(page.contains("No frame has a pose."));
        assert!(!page.contains("NaN"));
    }
}
