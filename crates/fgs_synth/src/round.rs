//! The path of a hand-held camera through a ring of rooms, back to where it began: through each room as
//! [`Walk`](crate::walk::Walk) goes, turning at the doorways.

use std::f64::consts::{PI, TAU};

use fgs_geom::Se3;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use crate::path::Hand;
use crate::room::Ring;
use crate::walk::through_room;

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
        let rooms = self.ring.rooms as f64;
        let passed = share.clamp(0.0, 1.0) * (rooms + 0.5);
        let (room, inside) = (passed.floor(), passed.fract());
        let ([ahead, aside], look) = through_room(room as usize % self.ring.rooms, inside);
        let yaw = TAU * room / rooms;
        let ([x, y], (sin, cos)) = (self.ring.middle(yaw), yaw.sin_cos());
        let along = ahead * self.ring.side_m;
        let position = [x + cos * along - sin * aside, y + sin * along + cos * aside];
        // Half of the turn to the next room is made before its doorway.
        let turn = -0.5 * TAU / rooms * (PI * inside).cos();
        (self.hand).world_from_camera(passed, position, yaw + turn + look)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::room::Room;
    use crate::shape::Ray;

    #[test]
    fn it_closes_and_nothing_is_in_the_way() {
        let (room, ring) = Room::unlit_ring(2, 7);
        let round = Round::new(2, ring);
        let poses: Vec<Se3> = (0..=1500)
            .map(|i| round.world_from_camera(i as f64 / 1500.0))
            .collect();
        // A round is 7 of 7.5 rooms.
        let apart = poses[0].inverse() * poses[1400];
        assert!(apart.log().norm() <= 1e-9, "{apart:?}");
        let mut length = 0.0;
        for pair in poses.windows(2) {
            let step = pair[0].inverse() * pair[1];
            assert!(
                step.translation.norm() <= 0.06 && step.rotation.angle() <= 0.1,
                "{step:?}"
            );
            length += step.translation.norm();
            let ray = Ray {
                origin: pair[0].translation,
                direction: pair[1].translation - pair[0].translation,
            };
            assert!(room.meet(&ray, None).is_none_or(|hit| hit.t > 5.0));
        }
        assert!(length >= 38.0, "{length}");
    }

    /// Rays in all directions end at something: there is no way to look out.
    #[test]
    fn it_is_closed_to_the_outside() {
        let (room, ring) = Room::unlit_ring(2, 7);
        let round = Round::new(2, ring);
        for i in 0..300 {
            let pose = round.world_from_camera(f64::from(i) / 300.0);
            for j in 0..200 {
                let z = (f64::from(j) + 0.5) / 100.0 - 1.0;
                let (sin, cos) = (2.399_963 * f64::from(j)).sin_cos();
                let r = (1.0 - z * z).sqrt();
                let ray = Ray {
                    origin: pose.translation,
                    direction: nalgebra::Vector3::new(r * cos, r * sin, z),
                };
                let hit = room.meet(&ray, None).unwrap();
                assert!(hit.t < 20.0, "at {}: {}", pose.translation, hit.t);
            }
        }
    }
}
