//! Scenarios in which tracking is likely to fail: the truth that comes with them is the truth.

#![allow(clippy::unwrap_used)]

use fgs_geom::Se3;
use fgs_synth::{Scenario, kinect_camera};
use nalgebra::Vector6;

fn scenario(name: &str) -> Scenario {
    Scenario::named(name, kinect_camera(64, 48).unwrap()).unwrap()
}

/// The true poses, seen from another world.
fn poses(scenario: &Scenario, found_from_world: &Se3) -> Vec<Option<(usize, Se3)>> {
    (0..scenario.len())
        .map(|index| Some((0, *found_from_world * scenario.world_from_camera(index))))
        .collect()
}

#[test]
fn poses_in_another_world_are_right_and_those_that_move_too_far_are_wrong() {
    let shake = scenario("shake");
    let found_from_world = Se3::exp(&Vector6::new(0.3, -0.8, 0.1, 1.0, 2.0, -0.5));
    let mut poses = poses(&shake, &found_from_world);
    let [moved, turned, lost] = [0, 1, 2].map(|i| shake.disturbed().start + i);
    let change = |pose: Option<(usize, Se3)>, by: Vector6<f64>| {
        pose.map(|(world, pose)| (world, pose * Se3::exp(&by)))
    };
    poses[moved] = change(poses[moved], Vector6::new(0.0, 0.0, 0.0, 0.0, 0.06, 0.0));
    poses[turned] = change(poses[turned], Vector6::new(0.06, 0.0, 0.0, 0.0, 0.0, 0.0));
    poses[lost] = None;
    for (index, error) in shake.errors(&poses).into_iter().enumerate() {
        match error {
            None => assert_eq!(index, lost),
            Some(error) if index == moved => {
                assert!((error.position_m - 0.06).abs() < 1e-6 && error.is_wrong());
            }
            Some(error) if index == turned => {
                assert!((error.rotation_rad - 0.06).abs() < 1e-6 && error.is_wrong());
            }
            Some(error) => assert!(error.position_m < 1e-6 && error.rotation_rad < 1e-6),
        }
    }
}

#[test]
fn a_shake_has_the_speed_that_it_says() {
    let shake = scenario("shake");
    let poses = poses(&shake, &Se3::identity());
    let (mut speed, mut turn) = (0f64, 0f64);
    for pair in poses.windows(2) {
        let step = pair[0].unwrap().1.inverse() * pair[1].unwrap().1;
        speed = speed.max(30.0 * step.translation.norm());
        turn = turn.max(30.0 * step.rotation.angle().to_degrees());
    }
    assert!((2.4..=3.9).contains(&speed), "{speed}");
    assert!((150.0..=240.0).contains(&turn), "{turn}");
}

#[test]
fn frames_that_come_again_are_the_same_but_for_their_time() {
    let repeated = scenario("repeated");
    let again = repeated.disturbed();
    let first = repeated.frame(again.start - 1);
    for index in again.clone() {
        let frame = repeated.frame(index);
        assert_eq!(frame.color, first.color);
        assert_eq!(frame.depth_m, first.depth_m);
        assert!(frame.timestamp_secs > first.timestamp_secs);
    }
    assert_ne!(repeated.frame(again.end).color, first.color);
}

#[test]
fn a_closed_lens_shows_nothing_and_a_covered_one_what_is_near() {
    let black = scenario("black");
    let frame = black.frame(black.disturbed().start);
    assert!(frame.color.data().iter().all(|pixel| *pixel == [0; 3]));
    assert!(frame.depth_m.data().iter().all(|depth| *depth == 0.0));
    let covered = scenario("covered");
    let frame = covered.frame(covered.disturbed().start);
    let near = frame.depth_m.data().iter();
    assert!(near.clone().filter(|depth| **depth > 0.0).count() > 64 * 48 / 2);
    assert!(near.clone().all(|depth| *depth < 0.6));
}

#[test]
fn someone_walks_in_front_of_what_is_there() {
    let scene = scenario("passer-by");
    let (before, middle) = (scene.disturbed().start, scene.disturbed().start + 40);
    let nearest = |index: usize| {
        let frame = scene.frame(index);
        let columns = 26..38;
        let depths = columns.map(|u| frame.depth_m.at(u, 24));
        depths.filter(|depth| *depth > 0.0).fold(f32::MAX, f32::min)
    };
    assert!(nearest(before) > 1.5 && (0.9..1.3).contains(&nearest(middle)));
}
