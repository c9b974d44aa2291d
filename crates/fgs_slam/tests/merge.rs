//! Two maps of one place become one, as if one session had seen both; maps of different places do not.

#![allow(clippy::unwrap_used)]

mod common;

use common::saved::Folder;
use common::scenario::{config, model};
use fgs_geom::{Camera, KeyframeId, RgbdFrame, Se3};
use fgs_slam::{Execution, FrameStatus, Slam, SlamError};
use fgs_splat::Gaussians;
use fgs_synth::{SensorModel, Sequence, kinect_camera};

/// A recording of part of a room, and the map that a session has made of it.
struct Part {
    sequence: Sequence,
    first: usize,
    folder: Folder,
    map: Gaussians,
}

impl Part {
    fn of(room: u64, camera: Camera, frames: std::ops::Range<usize>) -> Self {
        let sequence = Sequence::new(room, 200, camera, SensorModel::exact());
        let mut slam = Slam::new(&camera, &config(), Execution::Lockstep, model()).unwrap();
        slam.keep_new_keyframes();
        for index in frames.clone() {
            slam.push(sequence.frame(index)).unwrap();
        }
        let mut folder = Folder::default();
        folder.save(&mut slam);
        Self {
            first: frames.start,
            map: slam.snapshot().unwrap(),
            sequence,
            folder,
        }
    }

    /// The pose of a frame in the axes of the map of another part of the same room.
    fn truth(&self, frame: usize, other: &Self) -> Se3 {
        let world_from = |index| self.sequence.world_from_camera(index);
        world_from(other.first).inverse() * world_from(frame)
    }
}

fn camera() -> Camera {
    kinect_camera(160, 120).unwrap()
}

fn merged(first: &Part, second: &Part) -> Result<Option<Slam>, SlamError> {
    let folders = [&first.folder, &second.folder];
    let maps = folders.map(Folder::saved);
    let image_of = |map: usize, id| -> Result<RgbdFrame, SlamError> { folders[map].image(id) };
    Slam::merged(&config(), Execution::Lockstep, model(), maps, image_of)
}

#[test]
fn two_maps_that_meet_become_one_in_the_axes_of_the_first() {
    let first = Part::of(1, camera(), 0..50);
    let second = Part::of(1, camera(), 35..90);
    let mut slam = merged(&first, &second).unwrap().unwrap();
    // All of the first's is there, and of the second's what the first does not show.
    let both = slam.snapshot().unwrap();
    let (ours, theirs) = (first.map.len(), second.map.len());
    assert!(both.opacity_logits[..ours] == first.map.opacity_logits);
    assert!(both.len() > ours + theirs / 4 && both.len() < ours + theirs);
    // A camera finds itself where only the second map has been, in the axes of the first, and goes on.
    let found = [85, 86, 87].map(|index| slam.push(second.sequence.frame(index)).unwrap());
    assert_eq!(found[2].status, FrameStatus::Tracked);
    let pose = found[2].world_from_camera.unwrap();
    let off = pose.inverse() * second.truth(87, &first);
    assert!(off.translation.norm() < 0.01 && off.rotation.angle() < 0.005);
    let output = slam.finish();
    assert!(output.loops >= 1 && output.further.is_empty());
    let count = first.folder.saved().keyframes().len();
    assert!(output.keyframes.len() > count);
    for keyframe in &output.keyframes {
        let truth = first.truth(keyframe.index.0, &first);
        let off = keyframe.world_from_camera.inverse() * truth;
        assert!(off.translation.norm() < 0.01, "{keyframe:?}: {off:?}");
    }
}

#[test]
fn a_merged_map_can_be_saved_and_gone_on_with() {
    let first = Part::of(1, camera(), 0..50);
    let second = Part::of(1, camera(), 35..90);
    let follow = |slam: &mut Slam| {
        let frames = 80..86;
        let results = frames.map(|index| slam.push(second.sequence.frame(index)).unwrap());
        let poses = results.map(|result| result.world_from_camera);
        (poses.collect::<Vec<_>>(), slam.snapshot().unwrap())
    };
    let mut slam = merged(&first, &second).unwrap().unwrap();
    let saved = postcard::to_stdvec(&slam.save().unwrap()).unwrap();
    let saved: fgs_slam::SavedSession = postcard::from_bytes(&saved).unwrap();
    let begin = saved.keyframes().len() - second.folder.saved().keyframes().len();
    let image_of = |id: KeyframeId| match id.0.checked_sub(begin as u32) {
        Some(number) => second.folder.image(KeyframeId(number)),
        None => first.folder.image(id),
    };
    let mut again =
        Slam::restore(&config(), Execution::Lockstep, model(), saved, image_of).unwrap();
    assert!(follow(&mut slam) == follow(&mut again));
}

#[test]
fn maps_of_different_rooms_or_cameras_are_not_merged() {
    let first = Part::of(1, camera(), 0..30);
    assert!(
        merged(&first, &Part::of(2, camera(), 0..30))
            .unwrap()
            .is_none()
    );
    let other = kinect_camera(120, 90).unwrap();
    let error = merged(&first, &Part::of(1, other, 0..30)).err().unwrap();
    assert!(matches!(error, SlamError::OtherCameras { .. }), "{error}");
}
