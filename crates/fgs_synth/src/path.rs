//! The path of a hand-held camera: a closed loop around the middle of the room.
//!
//! Hand motion is a sum of sines with whole numbers of periods per loop, so the path is smooth and
//! closes exactly.

use std::f64::consts::{PI, TAU};

use fgs_geom::Se3;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Frames in one loop: 10 s at 30 frames per second, a calm walking pace.
pub const FRAMES_PER_LOOP: usize = 300;

/// Sway of one coordinate, as a sum of sines. Each is given by its periods per loop (a whole
/// number), amplitude and phase offset.
struct Sway(Vec<[f64; 3]>);

impl Sway {
    /// Slow sway of about `amplitude` in all, and the tremor of a hand (2 to 5 Hz).
    fn new(rng: &mut Pcg64Mcg, amplitude: f64, tremor: f64) -> Self {
        let mut sine = |periods: u32, amplitude: f64| {
            [f64::from(periods), amplitude, rng.random_range(0.0..TAU)]
        };
        let mut sines: Vec<_> = (2..=5)
            .map(|periods| sine(periods, amplitude / f64::from(periods)))
            .collect();
        sines.extend([19, 27, 37, 48].map(|periods| sine(periods, 0.5 * tremor)));
        Self(sines)
    }

    fn at(&self, phase: f64) -> f64 {
        let sine = |&[periods, amplitude, start]: &[f64; 3]| {
            amplitude * (TAU * periods * phase + start).sin()
        };
        self.0.iter().map(sine).sum()
    }
}

/// How a hand-held camera deviates from its nominal path.
pub(crate) struct Hand {
    position: [Sway; 3],
    yaw: Sway,
    pitch: Sway,
    roll: Sway,
}

impl Hand {
    pub fn new(rng: &mut Pcg64Mcg) -> Self {
        let degrees = PI / 180.0;
        Self {
            position: [0.16, 0.16, 0.12].map(|amplitude| Sway::new(rng, amplitude, 0.0012)),
            yaw: Sway::new(rng, 14.0 * degrees, 0.12 * degrees),
            pitch: Sway::new(rng, 12.0 * degrees, 0.1 * degrees),
            roll: Sway::new(rng, 4.0 * degrees, 0.08 * degrees),
        }
    }

    /// The pose of a camera whose nominal position is above (x, y), metres, and whose nominal
    /// heading is `yaw` (rad, 0 along x). It stays within 0.25 m of there and between 1.2 m and
    /// 1.8 m above the floor. The sway has period 1 in `phase`.
    pub fn world_from_camera(&self, phase: f64, [x, y]: [f64; 2], yaw: f64) -> Se3 {
        const EYE_HEIGHT: f64 = 1.5;
        /// Mean pitch, rad: downwards, so that floor and furniture fill the view rather than the
        /// ceiling.
        const PITCH: f64 = -0.30;
        let sway = Vector3::from_fn(|i, _| self.position[i].at(phase));
        let position = Vector3::new(x, y, EYE_HEIGHT) + sway;
        let yaw = yaw + self.yaw.at(phase);
        let pitch = PITCH + self.pitch.at(phase);
        let (sin_yaw, cos_yaw) = yaw.sin_cos();
        let (sin_pitch, cos_pitch) = pitch.sin_cos();
        let forward = Vector3::new(cos_yaw * cos_pitch, sin_yaw * cos_pitch, sin_pitch);
        let right = Vector3::new(sin_yaw, -cos_yaw, 0.0);
        let down = forward.cross(&right);
        let level =
            Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[right, down, forward]));
        let roll = Rotation3::from_axis_angle(&Vector3::z_axis(), self.roll.at(phase));
        Se3::new(
            UnitQuaternion::from_rotation_matrix(&(level * roll)),
            position,
        )
    }
}

/// A closed camera path around the middle of a room, looking across it.
pub struct CameraPath {
    start: f64,
    direction: f64,
    hand: Hand,
}

impl CameraPath {
    /// The path generated from a seed. It stays within 1.5 m of the vertical through the origin and
    /// between 1.2 m and 1.8 m above the floor.
    pub fn new(seed: u64) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(seed ^ 0xca3e_4a00);
        Self {
            start: rng.random_range(0.0..TAU),
            direction: if rng.random() { 1.0 } else { -1.0 },
            hand: Hand::new(&mut rng),
        }
    }

    /// The pose at `phase`, the fraction of the loop completed: 0 and 1 give the same pose. World
    /// frame: z up, metres.
    pub fn world_from_camera(&self, phase: f64) -> Se3 {
        // An ellipse with a circumference of 6.8 m, which clears the furniture along the walls.
        const RADII: [f64; 2] = [1.2, 0.95];
        let angle = self.start + self.direction * TAU * phase;
        let position = [RADII[0] * angle.cos(), RADII[1] * angle.sin()];
        // Across the room and somewhat ahead, so that near objects move through the view.
        let yaw = angle + self.direction * 0.8 * PI;
        self.hand.world_from_camera(phase, position, yaw)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(path: &CameraPath, frame: f64) -> Se3 {
        path.world_from_camera(frame / FRAMES_PER_LOOP as f64)
    }

    #[test]
    fn length_speed_and_turning_of_a_loop() {
        for seed in 0..8 {
            let path = CameraPath::new(seed);
            let (mut metres, mut degrees) = (0.0, 0.0);
            for i in 0..FRAMES_PER_LOOP - 1 {
                let (a, b) = (pose(&path, i as f64), pose(&path, (i + 1) as f64));
                metres += (b.translation - a.translation).norm();
                degrees += a.rotation.angle_to(&b.rotation).to_degrees();
            }
            let steps = (FRAMES_PER_LOOP - 1) as f64;
            println!(
                "seed {seed}: {metres:.2} m, {:.2} cm and {:.2} degrees a frame",
                100.0 * metres / steps,
                degrees / steps
            );
            assert!((6.0..=7.5).contains(&metres), "{metres}");
            assert!((0.015..=0.025).contains(&(metres / steps)));
            assert!(
                (0.7..=1.5).contains(&(degrees / steps)),
                "{}",
                degrees / steps
            );
        }
    }

    #[test]
    fn the_loop_closes_and_is_smooth() {
        let path = CameraPath::new(1);
        let gap = pose(&path, 0.0).inverse() * pose(&path, 300.0);
        assert!(gap.log().amax() <= 1e-9);
        for i in 0..300 {
            let [a, b, c] = [0.0, 1.0, 2.0].map(|k| pose(&path, i as f64 + k));
            // From frame to frame the velocity changes by at most what a hand does: 4 m/s^2 and
            // 250 degrees/s^2.
            let change = (a.inverse() * b).inverse() * (b.inverse() * c);
            assert!(change.log().fixed_rows::<3>(3).norm() <= 4.0 / 900.0);
            assert!(change.log().fixed_rows::<3>(0).norm().to_degrees() <= 250.0 / 900.0);
        }
    }

    #[test]
    fn the_camera_is_upright_within_bounds() {
        for seed in 0..8 {
            let path = CameraPath::new(seed);
            for i in 0..300 {
                let pose = pose(&path, f64::from(i));
                let position = pose.translation;
                assert!(position.xy().norm() <= 1.5);
                assert!((1.2..=1.8).contains(&position.z));
                let down = pose.rotation * Vector3::y();
                assert!(down.z <= -0.7, "{down}");
            }
        }
    }
}
