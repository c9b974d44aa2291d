//! A run's file, read back by Rerun's own decoder.

#![cfg(feature = "sdk")]
#![allow(clippy::unwrap_used, reason = "a test may panic, its helpers too")]

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::BufReader;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::thread::sleep;
use std::time::Duration;

use fgs_data::Trajectory;
use fgs_rerun::{Outcome, Outputs, RerunError, RerunView};
use fgs_slam::{Execution, Slam, SlamConfig, SlamOutput, drive, model_settings};
use fgs_splat::CpuModel;
use fgs_synth::{SensorModel, Sequence, kinect_camera};
use fgs_view::SiteKeyframe;
use re_log_encoding::DecoderApp;
use re_sdk::log::{Chunk, LogMsg};
use re_sdk_types::archetypes::{EncodedImage, GaussianSplats3D, LineStrips3D, Transform3D};
use re_sdk_types::components::LineStrip3D;

const FRAMES: usize = 8;

/// Before each frame. All of them take several times as long as it takes to ask for pictures again.
const PAUSE: Duration = Duration::from_millis(300);

/// What a file holds of each entity.
fn chunks(path: &Path) -> BTreeMap<String, Vec<Chunk>> {
    let mut chunks: BTreeMap<String, Vec<Chunk>> = BTreeMap::new();
    for message in DecoderApp::decode_lazy(BufReader::new(File::open(path).unwrap())) {
        if let LogMsg::ArrowMsg(_, message) = message.unwrap() {
            let chunk = Chunk::from_arrow_msg(&message).unwrap();
            let entity = chunk.entity_path().to_string();
            chunks.entry(entity).or_default().push(chunk);
        }
    }
    chunks
}

/// Runs a session over a small room, and shows it in a file.
fn run(path: &Path) -> (SlamOutput, Trajectory) {
    let camera = kinect_camera(80, 60).unwrap();
    let room = Sequence::new(3, 60, camera, SensorModel::exact());
    let config = SlamConfig::default();
    let model = Box::new(CpuModel::new(model_settings(&config.mapping)));
    let mut slam = Slam::new(&camera, &config, Execution::Lockstep, model).unwrap();
    let outputs = Outputs::open(false, Some(path)).unwrap();
    let mut view = RerunView::start(outputs, "room", &camera).unwrap();
    view.watch(&slam).unwrap();
    assert!(!path.exists());
    let frames = (0..FRAMES).map(|i| {
        // Pictures are asked for now and then, and come with the next frame.
        sleep(PAUSE);
        Ok::<_, std::io::Error>(room.frame(i))
    });
    drive(&mut slam, frames, &AtomicBool::new(false));
    let output = slam.finish();
    let poses = output.frames.iter();
    let poses = poses.filter_map(|frame| Some((frame.timestamp_secs?, frame.world_from_camera?)));
    let trajectory = Trajectory::new(poses).unwrap();
    let keyframes: Vec<SiteKeyframe> = (output.keyframes.iter())
        .map(|keyframe| SiteKeyframe {
            index: keyframe.index.0,
            kind: Some(keyframe.kind),
            world_from_camera: keyframe.world_from_camera,
        })
        .collect();
    let outcome = Outcome {
        keyframes: &keyframes,
        map: &output.gaussians,
        trajectory: &trajectory,
        reference: Some(&trajectory),
    };
    view.end(Some(&outcome)).unwrap();
    (output, trajectory)
}

#[test]
fn a_file_holds_the_map_the_poses_and_every_frame() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("room.rrd");
    let (output, trajectory) = run(&path);
    let names: Vec<_> = fs::read_dir(folder.path()).unwrap().collect();
    assert_eq!(names.len(), 1, "{names:?}");
    let chunks = chunks(&path);

    let frames: BTreeSet<i64> = chunks["/plots/gaussians"]
        .iter()
        .flat_map(|chunk| chunk.timelines()[&"frame".into()].times_raw().to_vec())
        .collect();
    assert_eq!(frames, (0..FRAMES as i64).collect());

    let centres = GaussianSplats3D::descriptor_centers().component;
    let maps: Vec<_> = (chunks["/world/map"].iter())
        .flat_map(|chunk| chunk.iter_slices::<[f32; 3]>(centres))
        .collect();
    assert_eq!(maps.last().unwrap(), &output.gaussians.means.as_slice());

    let translation = Transform3D::descriptor_translation().component;
    let poses = (chunks["/world/camera"].iter())
        .flat_map(|chunk| chunk.iter_slices::<[f32; 3]>(translation));
    assert_eq!(poses.count(), trajectory.poses().len());

    let strips = LineStrips3D::descriptor_strips().component;
    for entity in ["/world/trajectory", "/world/reference"] {
        let last = chunks[entity].last().unwrap();
        let ways: Vec<_> = last.iter_component::<LineStrip3D>(strips).collect();
        let way = &ways.last().unwrap().as_slice()[0].0;
        assert_eq!(way.len(), trajectory.poses().len(), "{entity}");
        for (point, pose) in way.iter().zip(trajectory.poses()) {
            let position = pose.world_from_camera.translation;
            assert_eq!([point.x(), point.y(), point.z()].map(f64::from), {
                let rounded = position.map(|x| f64::from(x as f32));
                <[f64; 3]>::from(rounded)
            });
        }
    }

    let is_keyframe = |name: &&String| {
        name.starts_with("/world/keyframes/tracking/")
            || name.starts_with("/world/keyframes/mapping/")
    };
    let keyframes = chunks.keys().filter(is_keyframe).count();
    assert_eq!(keyframes, output.keyframes.len());

    let blob = EncodedImage::descriptor_blob().component;
    for entity in ["/world/camera/image", "/pictures/render", "/pictures/depth"] {
        let pictures = chunks[entity].iter();
        let pictures = pictures.filter(|chunk| chunk.components().contains_key(&blob));
        assert!(pictures.count() > 0, "{entity}");
    }
}

#[test]
fn other_programs_files_stay_and_recordings_are_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("room.rrd");
    fs::write(&path, "a letter").unwrap();
    let refused = Outputs::open(false, Some(&path)).err();
    assert!(matches!(refused, Some(RerunError::Foreign { .. })));
    assert_eq!(fs::read(&path).unwrap(), b"a letter");
    fs::write(&path, "RRF2 of old").unwrap();
    let camera = kinect_camera(80, 60).unwrap();
    let view = RerunView::start(Outputs::open(false, Some(&path)).unwrap(), "room", &camera);
    view.unwrap().end(None).unwrap();
    assert!(chunks(&path).contains_key("/world"));
    let nowhere = Outputs::open(false, Some(&folder.path().join("no/room.rrd"))).err();
    assert!(matches!(nowhere, Some(RerunError::Write { .. })));
}
