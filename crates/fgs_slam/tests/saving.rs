//! A session that is saved and restored goes on as if nothing had been, to the last bit; and a saved map
//! takes up a camera that is lost.

#![allow(clippy::unwrap_used)]

mod common;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use common::saved::Folder;
use common::{config, cpu_model, poses, room, statuses, worst_position_error_m};
use fgs_geom::{FrameIndex, Image, RgbdFrame, Se3};
use fgs_slam::{Execution, FrameStatus, SavedSession, Slam, SlamConfig, SlamOutput};
use fgs_synth::{SensorModel, Sequence};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

fn started(sequence: &Sequence, config: &SlamConfig, execution: Execution) -> Slam {
    let mut slam = Slam::new(sequence.camera(), config, execution, cpu_model()).unwrap();
    slam.keep_new_keyframes();
    slam
}

/// Frames of a room. Three see nothing, and then the camera is back where it began; near the end it is fast.
fn hard_frames(sequence: &Sequence) -> Vec<RgbdFrame> {
    let order = (0..12).chain([0; 3]).chain(1..8).chain([13, 14, 15]);
    let frames = order.enumerate().map(|(i, shown)| {
        let mut frame = sequence.frame(shown);
        frame.index = FrameIndex(i);
        frame.timestamp_secs = sequence.frame(i).timestamp_secs;
        if (12..15).contains(&i) {
            frame.depth_m.data_mut().fill(0.0);
        }
        frame
    });
    frames.collect()
}

fn uninterrupted(sequence: &Sequence, config: &SlamConfig, frames: &[RgbdFrame]) -> SlamOutput {
    let mut slam = started(sequence, config, Execution::Lockstep);
    for frame in frames {
        slam.push(frame.clone()).unwrap();
    }
    slam.finish()
}

/// Saved and restored after each of some numbers of frames.
fn interrupted(
    sequence: &Sequence,
    config: &SlamConfig,
    frames: &[RgbdFrame],
    after: &[usize],
) -> SlamOutput {
    let mut folder = Folder::default();
    let mut slam = started(sequence, config, Execution::Lockstep);
    for i in 0..=frames.len() {
        if after.contains(&i) {
            folder.save(&mut slam);
            let saved = folder.saved();
            assert_eq!(saved.next_frame().0, i);
            slam = folder.restored(config, Execution::Lockstep, cpu_model(), saved);
            // Nothing is lost on the way, but for the time that has passed, which comes last.
            let again = postcard::to_stdvec(&slam.save().unwrap()).unwrap();
            let all_but_time = again.len().min(folder.state.len()) - 16;
            assert!(again[..all_but_time] == folder.state[..all_but_time]);
        }
        if let Some(frame) = frames.get(i) {
            slam.push(frame.clone()).unwrap();
        }
    }
    slam.finish()
}

fn assert_same(actual: &SlamOutput, expected: &SlamOutput, what: &str) {
    assert_eq!(statuses(actual), statuses(expected), "{what}");
    assert_eq!(poses(actual), poses(expected), "{what}");
    assert_eq!(actual.keyframes, expected.keyframes, "{what}");
    assert!(actual.gaussians == expected.gaussians, "{what}");
    assert!(actual.graph.poses().eq(expected.graph.poses()), "{what}");
    assert_eq!(actual.graph.edges(), expected.graph.edges(), "{what}");
    assert_eq!(actual.timings.steps, expected.timings.steps, "{what}");
    assert_eq!(actual.loops, expected.loops, "{what}");
}

/// The last frame is remembered for several reasons, but once.
#[test]
fn a_frame_is_saved_once() {
    let sequence = room(3);
    let mut slam = started(&sequence, &config(), Execution::Lockstep);
    for frame in sequence.frames() {
        slam.push(frame).unwrap();
    }
    let state = postcard::to_stdvec(&slam.save().unwrap()).unwrap();
    let color = sequence.frame(2).color.data().as_flattened().to_vec();
    let copies = state.windows(color.len()).filter(|part| **part == *color);
    assert_eq!(copies.count(), 1);
}

#[test]
fn a_restored_session_goes_on_to_the_last_bit() {
    let sequence = room(24);
    let frames = hard_frames(&sequence);
    let mut config = config();
    config.mapping.prune_every = 7;
    config.mapping.iterations_per_frame = 2.3;
    let whole = uninterrupted(&sequence, &config, &frames);
    // Found by the look of a place, which the next frame confirms.
    assert_eq!(statuses(&whole), "TTTTTTTTTTTTLLLWTTTTTTTTT");
    for (after, threads) in [
        (&[0, 1, 2][..], 1),
        (&[7], 4),
        (&[13, 15], 1),
        (&[16, 17, 22, 25], 4),
        (&[3, 4, 14, 20], 2),
    ] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        let pool = pool.build().unwrap();
        let again = pool.install(|| interrupted(&sequence, &config, &frames, after));
        assert_same(
            &again,
            &whole,
            &format!("after {after:?}, {threads} threads"),
        );
    }
}

/// The keyframes' images then differ from those that were tracked.
#[test]
fn also_where_two_sensors_roll_and_the_lens_leaves_a_border() {
    let sequence = room(16);
    let border = Image::from_fn(160, 120, |u, v| u > 2 && v < 117);
    let border = Arc::new(border);
    let frames: Vec<RgbdFrame> = (sequence.frames())
        .map(|mut frame| {
            frame.depth_sensor.delay_secs = 0.004;
            frame.depth_sensor.readout_secs = 0.01;
            frame.color_readout_secs = 0.01;
            frame.with_color_valid(Arc::clone(&border)).unwrap()
        })
        .collect();
    let whole = uninterrupted(&sequence, &config(), &frames);
    assert!(
        statuses(&whole).starts_with("TTTTTTTTTTTT"),
        "{}",
        statuses(&whole)
    );
    assert!(whole.keyframes.len() >= 3);
    let again = interrupted(&sequence, &config(), &frames, &[4, 12, 13]);
    assert_same(&again, &whole, "two sensors");
}

/// On threads of their own, tracker and mapper come to a rest, and go on.
#[test]
fn a_session_goes_on_in_every_mode() {
    let sequence = room(16);
    for execution in [Execution::Parallel, Execution::Realtime] {
        let mut folder = Folder::default();
        let mut slam = started(&sequence, &config(), execution);
        for (i, frame) in sequence.frames().enumerate() {
            if i == 8 {
                folder.save(&mut slam);
                drop(slam);
                let (config, saved) = (config(), folder.saved());
                slam = folder.restored(&config, execution, cpu_model(), saved);
            }
            slam.push(frame).unwrap();
        }
        let output = slam.finish();
        assert_eq!(statuses(&output), "T".repeat(16), "{execution:?}");
        let error_m = worst_position_error_m(&output, &sequence);
        assert!(error_m <= 0.01, "{execution:?}: {error_m} m");
    }
}

const MAPPED: usize = 40;

/// The map of a room's first frames, with its images.
fn map(sequence: &Sequence) -> Folder {
    let mut folder = Folder::default();
    let mut slam = started(sequence, &config(), Execution::Lockstep);
    for i in 0..MAPPED {
        slam.push(sequence.frame(i)).unwrap();
    }
    folder.save(&mut slam);
    folder
}

/// Frames as another recording: counted anew, on another clock.
fn another_recording(sequence: &Sequence, indices: impl Iterator<Item = usize>) -> Vec<RgbdFrame> {
    let frames = indices.enumerate().map(|(i, shown)| {
        let mut frame = sequence.frame(shown);
        frame.index = FrameIndex(i);
        frame.timestamp_secs = 1e6 + i as f64 / 30.0;
        frame
    });
    frames.collect()
}

/// Frames until the first pose, and the largest error of a pose in the map's world.
fn found(output: &SlamOutput, truth: impl Iterator<Item = Se3>) -> (usize, f64) {
    let poses = output.frames.iter().map(|frame| frame.world_from_camera);
    let first = poses.clone().position(|pose| pose.is_some());
    let errors = poses
        .zip(truth)
        .filter_map(|(pose, truth)| Some((pose?.translation - truth.translation).norm()));
    (first.unwrap_or(usize::MAX), errors.fold(0.0, f64::max))
}

/// Backwards through the second half of what was mapped.
#[test]
fn a_lost_camera_finds_itself_in_a_map_that_stays_as_it_is() {
    let sequence = room(100);
    let folder = map(&sequence);
    let start = sequence.world_from_camera(0).inverse();
    let indices = || (15..MAPPED).rev();
    let truth = || indices().map(|i| start * sequence.world_from_camera(i));
    for execution in Execution::ALL {
        let saved = folder.saved().into_map().localizing_only();
        let mut slam = folder.restored(&config(), execution, cpu_model(), saved);
        let before = slam.snapshot().unwrap();
        for frame in another_recording(&sequence, indices()) {
            slam.push(frame).unwrap();
        }
        assert!(slam.take_new_keyframes().is_empty());
        let output = slam.finish_refined(5, &AtomicBool::new(false));
        let (first, error_m) = found(&output, truth());
        assert!(first < 10, "{}", statuses(&output));
        assert!(error_m <= 0.02, "{execution:?}: {error_m} m");
        let poses = output.frames.iter().skip(10);
        assert!(
            poses
                .clone()
                .all(|frame| frame.status == FrameStatus::Tracked)
        );
        assert!(output.gaussians == before && output.refined.is_none());
        assert_eq!(output.timings.steps, 0);
    }
}

/// Through the second half of what was mapped, and on.
#[test]
fn a_lost_camera_extends_the_map_once_it_is_found() {
    let sequence = room(100);
    let folder = map(&sequence);
    let start = sequence.world_from_camera(0).inverse();
    let saved = folder.saved().into_map();
    let old_keyframes = saved.keyframes().len();
    let mut slam = folder.restored(&config(), Execution::Lockstep, cpu_model(), saved);
    let before = slam.snapshot().unwrap().len();
    for frame in another_recording(&sequence, 25..70) {
        slam.push(frame).unwrap();
    }
    let output = slam.finish();
    let truth = (25..70).map(|i| start * sequence.world_from_camera(i));
    let (first, error_m) = found(&output, truth);
    assert!(first < 10 && error_m <= 0.02, "{first}, {error_m} m");
    assert!(output.keyframes.len() > old_keyframes + 2);
    assert!(output.gaussians.len() > before + 100, "{before}");
    assert_eq!(output.frames.len(), 45);
}

/// Nothing in the map looks like another room, which becomes a sub-map if the map may grow.
#[test]
fn a_camera_elsewhere_is_not_found_in_the_map() {
    let sequence = room(100);
    let folder = map(&sequence);
    let elsewhere = Sequence::new(11, 100, *sequence.camera(), SensorModel::exact());
    let go = |saved: SavedSession| {
        let mut slam = folder.restored(&config(), Execution::Lockstep, cpu_model(), saved);
        for frame in another_recording(&elsewhere, 0..30) {
            slam.push(frame).unwrap();
        }
        slam.finish()
    };
    let fixed = go(folder.saved().into_map().localizing_only());
    assert_eq!(statuses(&fixed), "L".repeat(30));
    assert!(fixed.further.is_empty());
    let grown = go(folder.saved().into_map());
    let statuses = statuses(&grown);
    assert!(statuses.starts_with(&"L".repeat(10)) && statuses.ends_with("TTTTT"));
    assert!((grown.frames.iter()).all(|frame| frame.submap != Some(0)));
    assert_eq!(grown.further.len(), 1);
}

/// Bytes that no session wrote are refused, or make a session that runs; nothing panics.
#[test]
fn damaged_bytes_are_refused_or_harmless() {
    let sequence = room(6);
    let mut folder = Folder::default();
    let mut slam = started(&sequence, &config(), Execution::Lockstep);
    for frame in sequence.frames() {
        slam.push(frame).unwrap();
    }
    folder.save(&mut slam);
    let mut rng = Pcg64Mcg::seed_from_u64(5);
    let mut refused = 0;
    for round in 0..60 {
        let mut bytes = folder.state.clone();
        if round % 3 == 0 {
            bytes.truncate(rng.random_range(0..bytes.len()));
        } else {
            // What comes first decides over what follows.
            let at = (rng.random::<f64>().powi(6) * bytes.len() as f64) as usize;
            bytes[at] ^= 1 << rng.random_range(0..8);
        }
        let Ok(saved) = postcard::from_bytes::<SavedSession>(&bytes) else {
            refused += 1;
            continue;
        };
        let image = |id| folder.image(id);
        match Slam::restore(&config(), Execution::Lockstep, cpu_model(), saved, image) {
            Ok(mut slam) => drop(slam.push(sequence.frame(5))),
            Err(_) => refused += 1,
        }
    }
    assert!(refused >= 20, "{refused}");
}
