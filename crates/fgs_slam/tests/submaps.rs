//! A camera that is lost where nothing is known starts a sub-map, which is joined to the others when they
//! meet, and only then.

#![allow(clippy::unwrap_used)]

mod common;

use common::picture_at;
use common::saved::Folder;
use common::scenario::{Run, config, model};
use fgs_geom::RgbdFrame;
use fgs_slam::{Execution, FrameResult, FrameStatus, Slam, SlamOutput};
use fgs_splat::Gaussians;
use fgs_synth::{PoseError, Scenario, kinect_camera};

/// Frames within which a camera that sees well, but nothing that it knows, starts a sub-map.
const STARTS_WITHIN: usize = 20;

fn rmse_m<'a>(errors: impl Iterator<Item = &'a Option<PoseError>>) -> f64 {
    let squares: Vec<f64> = errors
        .flatten()
        .map(|error| error.position_m.powi(2))
        .collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

/// In its sub-map from the twentieth frame on, and where it is said to be there.
fn assert_starts_a_submap(run: &Run) {
    let disturbed = run.scenario.disturbed();
    for result in &run.disturbed()[STARTS_WITHIN..] {
        let index = result.index.0;
        assert_eq!(result.status, FrameStatus::Tracked, "frame {index}");
        assert_eq!(result.submap, Some(1), "frame {index}");
    }
    let error_m = rmse_m(run.errors()[disturbed].iter());
    assert!(error_m <= 0.02, "{error_m} m");
}

#[test]
fn another_room_becomes_a_submap_of_its_own_and_the_first_is_found_again() {
    let run = Run::of("other-room");
    run.assert_honest();
    run.assert_nothing_is_added_while_lost();
    assert_starts_a_submap(&run);
    run.assert_found_again();

    // Given out by themselves, each where its first camera was.
    let output = &run.output;
    assert_eq!((output.further.len(), output.loops), (1, 0));
    let in_second = |frame: &&FrameResult| frame.submap == Some(1);
    let count = output.frames.iter().filter(in_second).count();
    assert!(count >= 40, "{count}");
    let start = output.frames.iter().find(in_second).unwrap();
    assert!(start.world_from_camera.unwrap().log().norm() < 1e-9);
    for map in [&output.gaussians, &output.further[0].gaussians] {
        assert!(map.len() > 500);
        let far = |mean: &&[f32; 3]| mean.iter().any(|value| value.abs() > 20.0);
        assert_eq!(map.means.iter().find(far), None);
    }
    // None is missing; the closing keyframe brings more.
    let len = output.gaussians.len() + output.further[0].gaussians.len();
    assert!(len >= run.map.len(), "{len} of {}", run.map.len());
}

/// Every frame's view of the map is what it would be without the other sub-map.
#[test]
fn no_frame_sees_another_submap() {
    let run = Run::of("unknown-place");
    assert_starts_a_submap(&run);
    let is_far = |mean: &[f32; 3]| mean[1] < -50.0;
    let alone = |far: bool| {
        let mut map: Gaussians = run.map.clone();
        let keep: Vec<bool> = map.means.iter().map(|mean| is_far(mean) == far).collect();
        map.retain(&keep);
        map
    };
    let maps = [alone(false), alone(true)];
    let camera = run.scenario.camera();
    for result in run.results.iter().step_by(5) {
        let (Some(submap), Some(pose)) = (result.submap, result.world_from_camera) else {
            continue;
        };
        let seen = picture_at(&run.map, camera, pose);
        assert!(
            seen == picture_at(&maps[submap], camera, pose),
            "{:?}",
            result.index
        );
    }
}

#[test]
fn submaps_that_meet_are_joined() {
    let run = Run::of("meeting");
    run.assert_honest();
    run.assert_nothing_is_added_while_lost();
    let last = run.results.last().unwrap();
    assert_eq!((last.status, last.submap), (FrameStatus::Tracked, Some(0)));
    let output = &run.output;
    assert!(output.further.is_empty() && output.loops >= 1);
    let error_m = rmse_m(run.errors_at_the_end().iter());
    assert!(error_m <= 0.02, "{error_m} m");
    for error in run.errors_at_the_end().iter().flatten() {
        assert!(!error.is_wrong(), "{error:?}");
    }
}

/// The same furniture, but other small things.
#[test]
fn rooms_that_look_alike_are_not_joined() {
    let camera = kinect_camera(160, 120).unwrap();
    for seed in 3..8 {
        let run = Run::through(Scenario::look_alike(seed, camera));
        run.assert_honest();
        run.assert_nothing_is_added_while_lost();
        run.assert_found_again();
        assert_eq!(run.output.loops, 0, "seed {seed}");
    }
}

#[test]
fn darkness_starts_no_submap() {
    for name in ["black", "covered"] {
        let run = Run::of(name);
        run.assert_nothing_is_added_meanwhile();
        run.assert_found_again();
        assert!(run.output.further.is_empty(), "{name}");
    }
}

fn follow(
    frames: &[RgbdFrame],
    threads: usize,
    saved_at: impl Fn(usize) -> bool + Sync,
) -> SlamOutput {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
    pool.build().unwrap().install(|| {
        let (camera, lockstep) = (&frames[0].camera, Execution::Lockstep);
        let mut slam = Slam::new(camera, &config(), lockstep, model()).unwrap();
        slam.keep_new_keyframes();
        let mut folder = Folder::default();
        for (i, frame) in frames.iter().enumerate() {
            if saved_at(i) {
                folder.save(&mut slam);
                slam = folder.restored(&config(), lockstep, model(), folder.saved());
            }
            slam.push(frame.clone()).unwrap();
        }
        slam.finish()
    })
}

#[test]
fn a_restored_session_goes_on_to_the_last_bit() {
    let camera = kinect_camera(160, 120).unwrap();
    let scenario = Scenario::named("meeting", camera).unwrap();
    let frames: Vec<RgbdFrame> = scenario.frames().collect();
    let whole = follow(&frames, 1, |_| false);
    let again = follow(&frames, 2, |i| i > 50 && i % 7 == 3);
    assert_eq!(common::statuses(&again), common::statuses(&whole));
    assert!(common::poses(&again) == common::poses(&whole));
    assert_eq!(again.keyframes, whole.keyframes);
    assert_eq!(again.graph.edges(), whole.graph.edges());
    assert!(again.gaussians == whole.gaussians && again.further == whole.further);
    assert!(whole.loops > 0 && again.loops == whole.loops);
}
