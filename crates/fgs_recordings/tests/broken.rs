//! What is damaged or does not fit is named, in words that say what to do.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use std::fs::{self, File};
use std::io::Write;
use std::path::Path;

use common::bag::Transport;
use common::{Walk, lzfse, write};
use fgs_data::{CameraFile, Dataset, OpenOptions};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

fn open(path: &Path) -> Result<Dataset, String> {
    let opened = fgs_recordings::open(path, &OpenOptions::default());
    opened.map_err(|error| error.to_string())
}

/// Why it cannot be opened, or one of its frames not be read.
fn refusal(path: &Path) -> String {
    match open(path) {
        Err(error) => error,
        Ok(dataset) => {
            let mut errors = (0..dataset.len()).filter_map(|index| dataset.frame(index).err());
            errors.next().unwrap().to_string()
        }
    }
}

/// Record3D's files unpacked, which are easier to damage.
fn unpacked(folder: &Path) {
    let file = folder.join("packed");
    Walk::new().write_record3d(&file);
    let mut archive = zip::ZipArchive::new(File::open(&file).unwrap()).unwrap();
    archive.extract(folder.join("walk")).unwrap();
}

#[test]
fn record3d() {
    let folder = tempfile::tempdir().unwrap();
    unpacked(folder.path());
    let walk = folder.path().join("walk");
    assert!(open(&walk).is_ok());
    let says = |name: &str, bytes: &[u8], expected: &str| {
        let before = fs::read(walk.join(name)).unwrap();
        write(&walk, name, bytes);
        let refused = refusal(&walk);
        assert!(refused.contains(expected), "{name}: {refused}");
        assert!(refused.contains(name), "{name}: {refused}");
        write(&walk, name, &before);
    };
    says("metadata", b"{", "EOF");
    says("metadata", b"{\"K\": [1, 2]}", "matrix of 9 numbers");
    let metadata = fs::read_to_string(walk.join("metadata")).unwrap();
    let turned = metadata
        .replace("\"dw\":160", "\"dw\":120")
        .replace("\"dh\":120", "\"dh\":160");
    says("metadata", turned.as_bytes(), "does not show what colour");
    let huge = metadata.replace("\"dw\":160", "\"dw\":4000000000");
    says("metadata", huge.as_bytes(), "no phone's");
    says("rgbd/0.depth", b"bvx-", "LZFSE");
    says("rgbd/0.depth", &lzfse(&[0; 100]), "fewer than 76800 bytes");
    // However much it grows to.
    says(
        "rgbd/0.depth",
        &lzfse(&vec![0; 50_000_000]),
        "more than 76800 bytes",
    );
    says("rgbd/0.conf", &[1; 7], "LZFSE");
    says("rgbd/0.jpg", b"\xff\xd8", "cut short");
    // Poses that are damaged take nothing else along.
    let poseless = metadata.replace("\"poses\":[[", "\"poses\":[[1],[");
    write(&walk, "metadata", poseless.as_bytes());
    assert_eq!(
        open(&walk).unwrap().ground_truth().unwrap().poses().len(),
        11
    );
}

#[test]
fn archives() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("walk.r3d");
    Walk::new().write_record3d(&path);
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let refused = refusal(&path);
    assert!(refused.contains("the archive is damaged"), "{refused}");
    // An image that grows to more than any.
    let mut archive = ZipWriter::new(File::create(&path).unwrap());
    let options = SimpleFileOptions::default();
    archive.start_file("metadata", options).unwrap();
    archive.write_all(&vec![b' '; 200_000_000]).unwrap();
    archive.start_file("rgbd/0.jpg", options).unwrap();
    archive.finish().unwrap();
    assert!(fs::metadata(&path).unwrap().len() < 1_000_000);
    let refused = refusal(&path);
    assert!(refused.contains("longer than 134217728 bytes"), "{refused}");
    // All in one folder, as archives of folders are.
    let mut archive = ZipWriter::new(File::create(&path).unwrap());
    Walk::new().write_polycam(&folder.path().join("scan"));
    for kind in ["images", "cameras", "depth", "confidence"] {
        let files = folder.path().join("scan/keyframes").join(kind);
        for file in fs::read_dir(files).unwrap() {
            let file = file.unwrap();
            let name = file.file_name().into_string().unwrap();
            archive
                .start_file(format!("scan/keyframes/{kind}/{name}"), options)
                .unwrap();
            archive.write_all(&fs::read(file.path()).unwrap()).unwrap();
        }
    }
    archive.finish().unwrap();
    let dataset = open(&path).unwrap();
    assert_eq!(dataset.len(), common::FRAMES);
    assert!(dataset.frame(3).is_ok());
}

#[test]
fn names_do_not_lead_out_of_the_folder() {
    let folder = tempfile::tempdir().unwrap();
    let walk = folder.path().join("walk");
    Walk::new().write_nerfstudio(&walk);
    fs::copy(walk.join("images/0.jpg"), folder.path().join("0.jpg")).unwrap();
    let transforms = fs::read_to_string(walk.join("transforms.json")).unwrap();
    for name in ["../0.jpg", "/etc/passwd"] {
        let changed = transforms.replace("./images/0.jpg", name);
        assert!(changed != transforms);
        write(&walk, "transforms.json", changed.as_bytes());
        let refused = refusal(&walk);
        assert!(refused.contains("leads out of"), "{refused}");
    }
}

#[test]
fn bags() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("walk.mcap");
    Walk::new().write_bag(&path, Transport::RawAndPng);
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() - 5000]).unwrap();
    let refused = refusal(&path);
    assert!(refused.contains("damaged"), "{refused}");
    // Depth that was not moved to the colour camera.
    let write = |unwanted: &[&str]| {
        let is_wanted = |topic: &str| !unwanted.iter().any(|word| topic.contains(word));
        Walk::new().write_topics(&path, Transport::JpegAndRaw, 0..3, is_wanted);
    };
    write(&["aligned", "infra1"]);
    let refused = refusal(&path);
    assert!(
        refused.contains("no depth is registered to a colour camera"),
        "{refused}"
    );
    assert!(
        refused.contains("/camera/depth/image_rect_raw"),
        "{refused}"
    );
    // An infrared camera sees the pixels that its depth has; it has a lens of its own.
    write(&["aligned"]);
    let dataset = open(&path).unwrap();
    assert_eq!(dataset.frame(2).unwrap().color.at(5, 5), [2; 3]);
    let focal = dataset.camera().intrinsics.fx;
    assert_eq!(focal, 2.0 * common::camera(160, 120).intrinsics.fx);
    write(&["camera_info"]);
    let refused = refusal(&path);
    assert!(refused.contains("no camera_info"), "{refused}");
}

/// A camera of one's own takes the place of the recording's, if its images have that size.
#[test]
fn cameras() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("walk.r3d");
    Walk::new().write_record3d(&path);
    let with = |size: (usize, usize), depth_scale| {
        let camera = CameraFile::new(common::camera(size.0, size.1), None, depth_scale).unwrap();
        let options = OpenOptions {
            camera: Some(camera),
            ..OpenOptions::default()
        };
        fgs_recordings::open(&path, &options)
    };
    let refused = with((320, 240), 1000.0).err().unwrap().to_string();
    assert!(
        refused.contains("is 160x120, but the camera is 320x240"),
        "{refused}"
    );
    // Half as many units a metre: everything is twice as far.
    let usual = open(&path).unwrap();
    let scale = usual.camera_file().depth_scale();
    let far = with((160, 120), scale / 2.0).unwrap();
    let depth = |dataset: &Dataset| dataset.frame(0).unwrap().depth_m.at(80, 60);
    assert!((depth(&far) - 2.0 * depth(&usual)).abs() < 1e-5);
}
