//! Someone walks through the view.

use std::sync::Arc;

use fgs_geom::Se3;
use nalgebra::{UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::stage::{Guest, Stage};
use super::{SEED, Scenario, stretch};
use crate::builder::{Builder, Place};
use crate::decor::paint;
use crate::path::{CameraPath, FRAMES_PER_LOOP};
use crate::pattern::{Pattern, srgb};
use crate::room::Room;
use crate::sequence::FRAMES_PER_SECOND;

/// Someone walks by at a metre and a quarter, at a metre a second.
pub(super) fn passer_by(scenario: &mut Scenario) {
    let room = Arc::new(room_with_someone(|at| (at - 60.0) / FRAMES_PER_SECOND));
    scenario.film(&room, stretch(0.0, 20.0, 20));
    scenario.disturb(&room, stretch(20.0, 100.0, 80));
    scenario.film(&room, stretch(100.0, 110.0, 10));
}

/// Someone comes, stands before a slow camera for five seconds, and goes.
pub(super) fn visitor(scenario: &mut Scenario) {
    const SLOWNESS: f64 = 15.0;
    let comes = 52.0..55.0;
    let goes = 65.0..68.0;
    let (start, end) = (comes.start, goes.end);
    let room = Arc::new(room_with_someone(move |at| {
        let (left, right) = (comes.end - at, at - goes.start);
        (right.max(0.0) - left.max(0.0)) * SLOWNESS / FRAMES_PER_SECOND
    }));
    let frames = |points: f64| (SLOWNESS * points) as usize;
    scenario.film(&room, stretch(start - 2.0, start, frames(2.0)));
    scenario.disturb(&room, stretch(start, end, frames(end - start)));
    scenario.film(&room, stretch(end, end + 2.0, frames(2.0)));
}

/// Someone stands before a slow camera from the beginning, and goes at once.
pub(super) fn host(scenario: &mut Scenario) {
    leave(scenario, |secs| secs);
}

/// The same, but setting off gently.
pub(super) fn slow_host(scenario: &mut Scenario) {
    leave(scenario, |secs| {
        0.5 * secs.min(1.0).powi(2) + (secs - 1.0).max(0.0)
    });
}

/// Someone stands before a slow camera from the beginning, and then goes. `way_m` is how far they have gone
/// after so many seconds.
fn leave(scenario: &mut Scenario, way_m: impl Fn(f64) -> f64 + Send + Sync + 'static) {
    const SLOWNESS: f64 = 15.0;
    let goes = 60.0..63.0;
    let start = goes.start;
    let room = Arc::new(room_with_someone(move |at| {
        way_m((at - start).max(0.0) * SLOWNESS / FRAMES_PER_SECOND)
    }));
    let frames = |points: f64| (SLOWNESS * points) as usize;
    scenario.film(&room, stretch(goes.start - 4.0, goes.start, frames(4.0)));
    scenario.disturb(&room, stretch(goes.start, goes.end, frames(3.0)));
    scenario.film(&room, stretch(goes.end, goes.end + 2.0, frames(2.0)));
}

/// A room in which someone walks past the camera of frame 60, a metre and a quarter before it. `right_m`
/// says how far to the right of its view, by the point of the path.
fn room_with_someone(right_m: impl Fn(f64) -> f64 + Send + Sync + 'static) -> Stage {
    let camera = CameraPath::new(SEED).world_from_camera(60.0 / FRAMES_PER_LOOP as f64);
    let ahead = camera.rotation * Vector3::z();
    let right = camera.rotation * Vector3::x();
    let way = move |at: f64| {
        let place = camera.translation + 1.25 * ahead + right_m(at) * right;
        let on_floor = Vector3::new(place.x, place.y, 0.0);
        Se3::new(UnitQuaternion::identity(), on_floor)
    };
    Stage::furnished(SEED).with_guest(Guest {
        body: person(),
        way: Box::new(way),
    })
}

/// Someone 1.75 m tall in a striped shirt, at the origin.
fn person() -> Room {
    let mut builder = Builder::new(Pcg64Mcg::seed_from_u64(SEED));
    let at = Place::new([0.0; 3], 0.0);
    let shirt = Pattern::Stripes {
        colors: [srgb(0x2f4a5f), srgb(0xe0d6c0)],
        period: 0.08,
    };
    let trousers = Pattern::Cloth(srgb(0x3a3a48));
    builder.frustum(at, [0.0; 3], 0.85, [0.16, 0.2], trousers);
    builder.frustum(at, [0.0, 0.0, 0.85], 0.6, [0.2, 0.24], shirt);
    builder.ball(at, [0.0, 0.0, 1.6], [0.1, 0.1, 0.15], paint(0xc09a80));
    // Its own light, about that of a room.
    for finish in &mut builder.finishes {
        finish.glow = 0.4;
    }
    Room::unlit(builder, Vector3::new(0.5, 0.5, 1.75))
}
