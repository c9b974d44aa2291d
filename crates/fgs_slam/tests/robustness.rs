//! Verdicts are honest: what is called tracked is right, whatever happens to the camera.

#![allow(clippy::unwrap_used)]

mod common;

use common::scenario::Run;
use fgs_geom::Se3;
use fgs_slam::FrameStatus;
use fgs_synth::{Scenario, kinect_camera};
use nalgebra::Vector6;

#[test]
fn a_camera_in_the_dark_is_lost_until_it_sees_again() {
    for name in ["black", "covered"] {
        let run = Run::of(name);
        run.assert_honest();
        run.assert_nothing_is_added_meanwhile();
        run.assert_found_again();
    }
}

#[test]
fn a_jump_to_a_known_place_is_found() {
    let run = Run::of("known-place");
    run.assert_honest();
    run.assert_found_again();
}

#[test]
fn a_camera_that_nothing_holds_is_not_trusted() {
    for name in ["bare-wall", "corridor"] {
        Run::of(name).assert_honest();
    }
}

/// Where a device believes itself to be in a world of its own, in which distances are wrong by a factor.
fn device(scale: f64) -> impl Fn(&Se3) -> Option<Se3> {
    let own_from_world = Se3::exp(&Vector6::new(0.5, -1.0, 0.2, 4.0, -3.0, 1.0));
    move |truth| {
        let mut scaled = *truth;
        scaled.translation *= scale;
        Some(own_from_world * scaled)
    }
}

#[test]
fn a_device_that_tracks_itself_carries_the_camera_where_nothing_else_holds_it() {
    let scenario = || Scenario::named("corridor", kinect_camera(160, 120).unwrap()).unwrap();
    let statuses = |run: &Run| -> Vec<FrameStatus> {
        run.results.iter().map(|result| result.status).collect()
    };
    let lost = |run: &Run| {
        let statuses = statuses(run).into_iter();
        statuses
            .filter(|status| *status == FrameStatus::Lost)
            .count()
    };
    let alone = Run::through(scenario());
    let carried = Run::with_device(scenario(), device(1.01));
    carried.assert_honest();
    println!("{} lost, alone {}", lost(&carried), lost(&alone));
    // Two seconds more.
    assert!(lost(&carried) + 50 <= lost(&alone));

    let misled = Run::with_device(scenario(), device(3.0));
    assert!(statuses(&misled) == statuses(&alone));
}

#[test]
fn someone_who_walks_by_or_stays_a_while_does_not_take_the_camera_along() {
    for name in ["passer-by", "visitor"] {
        let run = Run::of(name);
        run.assert_honest();
        run.assert_found_again();
    }
}

#[test]
fn someone_who_was_there_and_leaves_does_not_take_the_camera_along() {
    for name in ["host", "slow-host"] {
        let run = Run::of(name);
        run.assert_honest();
        run.assert_found_again();
    }
}

#[test]
fn fast_and_rare_frames_are_followed_and_new_exposures_too() {
    for name in ["shake", "5-hz", "exposure"] {
        let run = Run::of(name);
        run.assert_honest();
        run.assert_found_again();
    }
}

#[test]
fn a_frame_that_comes_again_stands_still() {
    let run = Run::of("repeated");
    run.assert_honest();
    let first = run.scenario.disturbed().start - 1;
    let first = run.results[first].world_from_camera.unwrap();
    for again in run.disturbed() {
        assert_eq!(again.status, FrameStatus::Tracked);
        let moved = first.inverse() * again.world_from_camera.unwrap();
        assert!(moved.translation.norm() < 0.002, "{moved:?}");
        assert!(moved.rotation.angle() < 0.002, "{moved:?}");
    }
    run.assert_found_again();
}
