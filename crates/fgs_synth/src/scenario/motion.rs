//! Motions that no motion model predicts.

use std::f64::consts::TAU;
use std::sync::Arc;

use fgs_geom::Se3;
use nalgebra::Vector6;

use super::stage::Stage;
use super::{SEED, Scenario, Shot, stretch};
use crate::path::{CameraPath, FRAMES_PER_LOOP};
use crate::room::Room;
use crate::sequence::FRAMES_PER_SECOND;

/// Nothing happens: what tracking is like then.
pub(super) fn normal(scenario: &mut Scenario) {
    let room = Arc::new(Stage::furnished(SEED));
    scenario.film(&room, stretch(0.0, 30.0, 30));
    scenario.disturb(&room, stretch(30.0, 60.0, 30));
    scenario.film(&room, stretch(60.0, 80.0, 20));
}

/// Cut to another room and back.
pub(super) fn other_room(scenario: &mut Scenario) {
    visit(scenario, SEED, Stage::furnished(SEED + 1).elsewhere(), 0.0);
}

/// Cut to a room with the same furniture but other small things in it, and back.
pub(super) fn look_alike(scenario: &mut Scenario) {
    look_alike_of(SEED, scenario);
}

pub(super) fn look_alike_of(seed: u64, scenario: &mut Scenario) {
    let room = Stage::with_loop(Room::look_alike(seed), seed);
    visit(scenario, seed, room.elsewhere(), 20.0);
}

fn visit(scenario: &mut Scenario, seed: u64, other: Stage, at: f64) {
    let room = Arc::new(Stage::furnished(seed));
    scenario.film(&room, stretch(0.0, 50.0, 50));
    scenario.disturb(&Arc::new(other), stretch(at, at + 60.0, 60));
    scenario.film(&room, stretch(30.0, 50.0, 20));
}

/// A second of up to 3 m/s and 180 degrees/s, to and fro.
pub(super) fn shake(scenario: &mut Scenario) {
    const PER_SECOND: f64 = 2.5;
    let path = CameraPath::new(SEED);
    let shaken = move |at: f64| {
        let secs = (at - 30.0) / FRAMES_PER_SECOND;
        let phase = TAU * PER_SECOND * secs.clamp(0.0, 1.0);
        // The derivative of amplitude x sin(phase) peaks at amplitude x its rate.
        let rate = TAU * PER_SECOND;
        let (turn, shift) = (180f64.to_radians() / rate, 3.0 / rate);
        let sway = Vector6::new(0.0, turn, 0.0, shift, 0.0, 0.0) * phase.sin();
        path.world_from_camera(at / FRAMES_PER_LOOP as f64) * Se3::exp(&sway)
    };
    let room = Arc::new(Stage::new(Room::new(SEED), shaken));
    scenario.film(&room, stretch(0.0, 30.0, 30));
    scenario.disturb(&room, stretch(30.0, 60.0, 30));
    scenario.film(&room, stretch(60.0, 80.0, 20));
}

/// The camera jumps to where it has been.
pub(super) fn known_place(scenario: &mut Scenario) {
    let room = Arc::new(Stage::furnished(SEED));
    scenario.film(&room, stretch(0.0, 60.0, 60));
    scenario.disturb(&room, [10.0]);
    scenario.film(&room, stretch(11.0, 41.0, 30));
}

/// The camera jumps to the other side of the room, which it has not seen, and back.
pub(super) fn unknown_place(scenario: &mut Scenario) {
    let room = Arc::new(Stage::furnished(SEED));
    scenario.film(&room, stretch(0.0, 50.0, 50));
    scenario.disturb(&room, stretch(150.0, 180.0, 30));
    scenario.film(&room, stretch(30.0, 50.0, 20));
}

/// The camera jumps to the other side of the room, and comes back from there.
pub(super) fn meeting(scenario: &mut Scenario) {
    let room = Arc::new(Stage::furnished(SEED));
    scenario.film(&room, stretch(0.0, 50.0, 50));
    scenario.disturb(&room, stretch(150.0, 60.0, 60));
    scenario.film(&room, stretch(60.0, 0.0, 40));
}

/// Every sixth frame of a normal motion.
pub(super) fn five_hz(scenario: &mut Scenario) {
    let room = Arc::new(Stage::furnished(SEED));
    scenario.film(&room, stretch(0.0, 30.0, 30));
    let start = scenario.len();
    scenario.disturb(&room, stretch(35.0, 215.0, 30));
    for (step, shot) in scenario.shots[start..].iter_mut().enumerate() {
        shot.time += 5.0 * (step + 1) as f64;
        shot.exposure = shot.time as usize;
    }
    scenario.film(&room, stretch(210.0, 230.0, 20));
}

/// Every frame comes twice, the second time half a frame later.
pub(super) fn twice(scenario: &mut Scenario) {
    let room = Arc::new(Stage::furnished(SEED));
    scenario.film(&room, stretch(0.0, 20.0, 20));
    scenario.disturb(&room, stretch(20.0, 50.0, 30));
    let twice = (scenario.shots.split_off(20).into_iter()).flat_map(|shot| {
        let time = shot.time + 0.5;
        [shot.clone(), Shot { time, ..shot }]
    });
    scenario.shots.extend(twice);
    scenario.disturbed = 20..scenario.len();
    scenario.film(&room, stretch(50.0, 60.0, 10));
}

/// A frame comes three times, as of a camera that hangs, and then what comes after three frames.
pub(super) fn repeated(scenario: &mut Scenario) {
    let room = Arc::new(Stage::furnished(SEED));
    scenario.film(&room, stretch(0.0, 30.0, 30));
    if let Some(last) = scenario.shots.last().cloned() {
        for late in [1.0, 2.0] {
            let time = last.time + late;
            scenario.shots.push(Shot {
                time,
                ..last.clone()
            });
        }
    }
    scenario.disturbed = 30..32;
    scenario.film(&room, stretch(32.0, 42.0, 10));
}
