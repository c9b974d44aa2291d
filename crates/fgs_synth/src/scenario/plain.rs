//! Places with little to hold on to.

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use fgs_geom::Se3;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::stage::Stage;
use super::{SEED, Scenario, stretch};
use crate::builder::{Builder, Place};
use crate::decor::{paint, painting};
use crate::furniture::{bookcase, sideboard};
use crate::layout::WALL_M;
use crate::pattern::{Rgb, srgb};
use crate::room::Room;
use crate::sequence::FRAMES_PER_SECOND;

/// From a bookcase along a wall without anything on it, a metre away, and back.
pub(super) fn bare_wall(scenario: &mut Scenario) {
    let mut builder = empty_room([6.0, 4.0, 2.6]);
    builder.lamp(floor(), [0.0, 0.0, 2.5], [0.5, 0.5, 0.02], Rgb::repeat(1.0));
    let behind = floor().at([-1.1, 2.0, 0.0], 2.0 * FRAC_PI_2);
    bookcase(&mut builder, behind, 1.05, 1.9, srgb(0xb98a5a));
    let room = builder.lit([6.0, 4.0, 2.6]);
    let looking_across = facing(FRAC_PI_2, 0.0);
    to_and_fro(scenario, room, 1.0, 2.4, move |way_m| {
        Se3::new(looking_across, Vector3::new(way_m - 1.6, 0.9, 1.5))
    });
}

/// Along an empty corridor, past the furniture at its beginning, and back. Its end is too far for depth.
pub(super) fn corridor(scenario: &mut Scenario) {
    let size = [14.0, 1.8, 2.5];
    let mut builder = empty_room(size);
    for x in [-4.7, 0.0, 4.7] {
        let (center, half) = ([x, 0.0, 2.4], [2.3, 0.1, 0.02]);
        builder.lamp(floor(), center, half, Rgb::repeat(1.0));
    }
    let right = floor().at([-5.0, -0.9, 0.0], 0.0);
    sideboard(&mut builder, right, 0.6, 0.8, srgb(0x8a5a36));
    let left = floor().at([-4.7, 0.9, 1.5], 2.0 * FRAC_PI_2);
    painting(&mut builder, left, [0.6, 0.5]);
    let room = builder.lit(size);
    let looking_along = facing(0.0, -0.15);
    to_and_fro(scenario, room, 1.2, 2.8, move |way_m| {
        Se3::new(looking_along, Vector3::new(way_m - 6.5, 0.0, 1.5))
    });
}

/// Stands, goes `far_m` at `speed` metres per second and comes back.
fn to_and_fro(
    scenario: &mut Scenario,
    room: Room,
    speed: f64,
    far_m: f64,
    pose: impl Fn(f64) -> Se3 + Send + Sync + 'static,
) {
    let frames = (far_m / speed * FRAMES_PER_SECOND).round();
    let way_m = move |at: f64| far_m / frames * (frames - (at.max(0.0) - frames).abs()).max(0.0);
    let stage = Arc::new(Stage::new(room, move |at| pose(way_m(at))));
    scenario.film(&stage, stretch(-15.0, 0.0, 15));
    let both_ways = 2.0 * frames;
    scenario.disturb(&stage, stretch(0.0, both_ways, both_ways as usize));
    scenario.film(&stage, stretch(both_ways, both_ways + 15.0, 15));
}

fn floor() -> Place {
    Place::new([0.0; 3], 0.0)
}

/// Painted all over, without lamps; x, y, z are its inner sizes in metres.
fn empty_room([x, y, z]: [f64; 3]) -> Builder {
    const T: f64 = WALL_M;
    let mut builder = Builder::new(Pcg64Mcg::seed_from_u64(SEED));
    let (x, y) = (0.5 * x, 0.5 * y);
    let [pale, gray, white] = [0xdcd8cc, 0x8a8a88, 0xe9e7e2].map(paint);
    for (low, high, pattern) in [
        ([-x - T, -y - T, 0.0], [x + T, -y, z], pale),
        ([-x - T, y, 0.0], [x + T, y + T, z], pale),
        ([x, -y - T, 0.0], [x + T, y + T, z], pale),
        ([-x - T, -y - T, 0.0], [-x, y + T, z], pale),
        ([-x - T, -y - T, -T], [x + T, y + T, 0.0], gray),
        ([-x - T, -y - T, z], [x + T, y + T, z + T], white),
    ] {
        builder.block(floor(), low, high, pattern);
    }
    builder
}

impl Builder {
    fn lit(self, size: [f64; 3]) -> Room {
        Room::unlit(self, size.into()).lit(SEED)
    }
}

/// The rotation of a camera that looks along a heading, rad from x towards y, and down by -`pitch`.
fn facing(yaw: f64, pitch: f64) -> UnitQuaternion<f64> {
    let (sin, cos) = yaw.sin_cos();
    let forward = Vector3::new(cos * pitch.cos(), sin * pitch.cos(), pitch.sin());
    let right = Vector3::new(sin, -cos, 0.0);
    let axes = Matrix3::from_columns(&[right, forward.cross(&right), forward]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes))
}
