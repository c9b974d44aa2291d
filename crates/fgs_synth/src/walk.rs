//! The path of a hand-held camera through a row of rooms. It passes beside the middle of each room
//! while looking around, and goes straight through the doorways while looking ahead.
//!
//! The nominal path is a smooth function of x, which advances at constant speed.

use std::f64::consts::PI;

use fgs_geom::Se3;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use crate::path::Hand;

/// How far before the middle of the first room the walk starts, and beyond the middle of the last
/// it ends, metres.
const END_M: f64 = 1.2;

/// How far the camera yaws across a room and back, rad: beside the middle of the room it faces the opposite
/// wall and sees some of what lies back along the path.
pub(crate) const SWEEP: f64 = 2.2;

/// A camera path from the first room of a row to the last.
pub(crate) struct Walk {
    /// x where each room begins, and where the last one ends, metres.
    thresholds: Vec<f64>,
    hand: Hand,
}

impl Walk {
    /// The walk generated from a seed, through the rooms between these thresholds.
    pub fn new(seed: u64, thresholds: &[f64]) -> Self {
        Self {
            thresholds: thresholds.to_vec(),
            hand: Hand::new(&mut Pcg64Mcg::seed_from_u64(seed ^ 0xca3e_4a01)),
        }
    }

    /// The pose after a fraction of the walk, 0 to 1. World frame: z up, metres.
    pub fn world_from_camera(&self, share: f64) -> Se3 {
        let share = share.clamp(0.0, 1.0);
        let rooms = self.thresholds.len() - 1;
        let middle = |room: usize| 0.5 * (self.thresholds[room] + self.thresholds[room + 1]);
        let (start, end) = (middle(0) - END_M, middle(rooms - 1) + END_M);
        let x = start + share * (end - start);
        let doorways_behind = self.thresholds[1..rooms].iter().filter(|door| **door <= x);
        let room = doorways_behind.count();
        let (from, to) = (self.thresholds[room], self.thresholds[room + 1]);
        let ([_, aside], look) = through_room(room, (x - from) / (to - from));
        (self.hand).world_from_camera(share * rooms as f64, [x, aside], look)
    }
}

/// The nominal way through the room of a number, when a share of the way from doorway to doorway has been
/// gone: how far ahead of its middle (of the way through) and to its left (metres), and where the
/// camera looks (rad, 0 ahead).
pub(crate) fn through_room(room: usize, share: f64) -> ([f64; 2], f64) {
    /// How far the path bends sideways around the middle of a room, metres, as the loop in a single
    /// room does.
    const BEND_M: f64 = 0.95;
    // 0 with zero slope at the doorways, 1 beside the middle.
    let inside = (PI * share).sin().powi(2);
    // Passes the middles of successive rooms on alternating sides.
    let side = if room.is_multiple_of(2) { 1.0 } else { -1.0 };
    (
        [share - 0.5, -side * BEND_M * inside],
        side * SWEEP * inside,
    )
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::path::FRAMES_PER_LOOP;
    use crate::room::Room;
    use crate::shape::{Ray, directions};

    const ROOMS: usize = 4;
    const FRAMES: usize = ROOMS * FRAMES_PER_LOOP;

    fn poses(walk: &Walk) -> Vec<Se3> {
        (0..FRAMES)
            .map(|i| walk.world_from_camera(i as f64 / (FRAMES - 1) as f64))
            .collect()
    }

    /// Whether the line segment between two points is unobstructed.
    fn is_free(room: &Room, from: Vector3<f64>, to: Vector3<f64>) -> bool {
        let ray = Ray {
            origin: from,
            direction: to - from,
        };
        room.meet(&ray, None).is_none_or(|hit| hit.t > 1.0)
    }

    #[test]
    fn neither_walls_nor_furniture_are_in_the_way() {
        for seed in 0..3 {
            let room = Room::unlit_row(seed, ROOMS);
            let poses = poses(&Walk::new(seed, room.thresholds()));
            let mut nearest = f64::INFINITY;
            for pair in poses.windows(2) {
                let [from, to] = [pair[0].translation, pair[1].translation];
                assert!(is_free(&room, from, to), "{from} to {to}");
                for direction in directions() {
                    let ray = Ray {
                        origin: from,
                        direction,
                    };
                    nearest = nearest.min(room.meet(&ray, None).unwrap().t);
                }
            }
            println!("seed {seed}: at least {nearest:.2} m from everything");
            assert!(nearest >= 0.25, "{nearest}");
            // The walk spans the first room to the last.
            let [first, last] = [poses[0], poses[FRAMES - 1]].map(|pose| pose.translation.x);
            assert!(first >= room.thresholds()[0] && first < room.thresholds()[1]);
            assert!(last > room.thresholds()[ROOMS - 1] && last <= room.thresholds()[ROOMS]);
        }
    }

    #[test]
    fn doorways_are_open_and_the_walls_about_them_are_not() {
        let room = Room::unlit_row(1, ROOMS);
        for &x in &room.thresholds()[1..ROOMS] {
            let is_open = |y: f64, z: f64| {
                is_free(
                    &room,
                    Vector3::new(x - 0.6, y, z),
                    Vector3::new(x + 0.6, y, z),
                )
            };
            for (y, z) in [
                (0.0, 0.02),
                (0.49, 1.0),
                (-0.49, 1.5),
                (0.3, 2.09),
                (-0.49, 2.09),
            ] {
                assert!(is_open(y, z), "{y} {z}");
            }
            for (y, z) in [(0.51, 1.0), (-0.51, 1.5), (0.0, 2.11), (1.5, 0.5)] {
                assert!(!is_open(y, z), "{y} {z}");
            }
        }
    }

    #[test]
    fn the_pace_is_even_and_turning_smooth() {
        for seed in 0..8 {
            let walk = Walk::new(seed, Room::unlit_row(seed, ROOMS).thresholds());
            let poses = poses(&walk);
            let (mut metres, mut degrees) = (0.0, 0.0);
            for pair in poses.windows(3) {
                let [first, second] = [0, 1].map(|i| pair[i].inverse() * pair[i + 1]);
                metres += first.translation.norm();
                let turn = first.rotation.angle().to_degrees();
                degrees += turn;
                assert!(first.translation.norm() <= 0.04 && turn <= 4.0);
                // As in a single room: at most 4 m/s^2 and 250 degrees/s^2.
                let change = (first.inverse() * second).log();
                assert!(change.fixed_rows::<3>(3).norm() <= 4.0 / 900.0);
                assert!(change.fixed_rows::<3>(0).norm().to_degrees() <= 250.0 / 900.0);
            }
            let steps = (FRAMES - 2) as f64;
            println!(
                "seed {seed}: {:.2} cm and {:.2} degrees a frame",
                100.0 * metres / steps,
                degrees / steps
            );
            assert!((0.015..=0.025).contains(&(metres / steps)));
            assert!((0.7..=1.5).contains(&(degrees / steps)));
        }
    }
}
