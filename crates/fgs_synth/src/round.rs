//! The path of a hand-held camera through a ring of rooms, back to where it began. It goes through rooms as
//! [`Walk`](crate::walk::Walk) does; in those at the ends of the rows it turns left, and looks to the right,
//! across them.

use std::f64::consts::{FRAC_PI_2, PI};

use fgs_geom::Se3;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use crate::path::Hand;
use crate::room::Ring;
use crate::walk::{SWEEP, through_room};

/// A camera path once round a ring of rooms.
pub(crate) struct Round {
    ring: Ring,
    hand: Hand,
}

impl Round {
    /// The path generated from a seed.
    pub fn new(seed: u64, ring: Ring) -> Self {
        Self {
            ring,
            hand: Hand::new(&mut Pcg64Mcg::seed_from_u64(seed ^ 0xca3e_4a02)),
        }
    }

    /// The pose after a fraction of the walk, 0 to 1: from a doorway once round and on to the middle of
    /// the first room. World frame: z up, metres.
    pub fn world_from_camera(&self, share: f64) -> Se3 {
        let rooms = self.ring.rooms();
        let passed = share.clamp(0.0, 1.0) * (rooms as f64 + 0.5);
        let (room, inside) = (passed.floor() as usize % rooms, passed.fract());
        let ([ahead, aside], look) = if self.ring.turns(room) {
            let ([ahead, aside], look) = around_corner(inside);
            ([ahead, self.ring.pitch_m * aside], look)
        } else {
            through_room(room, inside)
        };
        let ([x, y], yaw) = self.ring.frame(room);
        let (sin, cos) = yaw.sin_cos();
        let ahead = self.ring.pitch_m * ahead;
        let position = [x + cos * ahead - sin * aside, y + sin * ahead + cos * aside];
        (self.hand).world_from_camera(passed, position, yaw + look)
    }
}

/// The nominal way through a room in which it turns left, as [`through_room`], but both distances are
/// multiples of the one between rooms: a parabola from doorway to doorway.
fn around_corner(share: f64) -> ([f64; 2], f64) {
    let position = [-0.5 * (1.0 - share).powi(2), 0.5 * share.powi(2)];
    let turn = FRAC_PI_2 * (FRAC_PI_2 * share).sin().powi(2);
    (position, turn - SWEEP * (PI * share).sin().powi(2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path::FRAMES_PER_LOOP;
    use crate::room::Room;
    use crate::shape::{Ray, directions};

    #[test]
    fn it_closes_and_nothing_is_in_the_way_and_there_is_no_way_to_look_out() {
        for (seed, columns) in (0..6).zip([2, 3, 4].into_iter().cycle()) {
            let (room, ring) = Room::unlit_ring(seed, columns);
            let round = Round::new(seed, ring);
            let frames = (ring.rooms() * FRAMES_PER_LOOP, FRAMES_PER_LOOP / 2);
            let pose = |i: usize| round.world_from_camera(i as f64 / (frames.0 + frames.1) as f64);
            let apart = pose(0).inverse() * pose(frames.0);
            assert!(apart.log().norm() <= 1e-9, "{apart:?}");
            let poses: Vec<Se3> = (0..=frames.0).map(pose).collect();
            let (mut metres, mut nearest) = (0.0, f64::INFINITY);
            for pair in poses.windows(2) {
                let step = pair[0].inverse() * pair[1];
                metres += step.translation.norm();
                let turn = step.rotation.angle().to_degrees();
                assert!(step.translation.norm() <= 0.04 && turn <= 4.0, "{step:?}");
                let [from, to] = [pair[0].translation, pair[1].translation];
                let meet = |direction| {
                    let ray = Ray {
                        origin: from,
                        direction,
                    };
                    room.meet(&ray, None).unwrap().t
                };
                assert!(meet(to - from) > 1.0, "{from} to {to}");
                for direction in directions() {
                    let distance_m = meet(direction);
                    nearest = nearest.min(distance_m);
                    assert!(distance_m < 20.0, "at {from}: {distance_m}");
                }
            }
            println!("seed {seed}: {metres:.1} m, at least {nearest:.2} m from everything");
            assert!(nearest >= 0.25, "{nearest}");
            assert!(metres >= 4.5 * ring.rooms() as f64, "{metres}");
        }
    }

    #[test]
    fn turning_and_pace_are_smooth() {
        for seed in 0..8 {
            let (_, ring) = Room::unlit_ring(seed, 3);
            let round = Round::new(seed, ring);
            let frames = ring.rooms() * FRAMES_PER_LOOP;
            let len = (frames + FRAMES_PER_LOOP / 2) as f64;
            let poses: Vec<Se3> = (0..=frames)
                .map(|i| round.world_from_camera(i as f64 / len))
                .collect();
            for three in poses.windows(3) {
                let [first, second] = [0, 1].map(|i| three[i].inverse() * three[i + 1]);
                // As in a single room: at most 4 m/s^2 and 250 degrees/s^2.
                let change = (first.inverse() * second).log();
                assert!(change.fixed_rows::<3>(3).norm() <= 4.0 / 900.0);
                assert!(change.fixed_rows::<3>(0).norm().to_degrees() <= 250.0 / 900.0);
            }
        }
    }
}
