//! A camera before walls with posters, in closed form, so that each row of an image can be taken at a
//! moment of its own.

use fgs_geom::{
    Camera, DepthSensor, FrameIndex, Image, Intrinsics, RgbdFrame, Se3, row_delay_secs,
};
use fgs_slam::{Execution, Slam, SlamConfig, model_settings};
use fgs_splat::CpuModel;
use nalgebra::{UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

const FRAMES_PER_SEC: f64 = 30.0;

/// What the camera sees and how it moves.
pub struct Posters {
    /// A floor and a wall at the side, so that geometry holds the camera too.
    pub corner: bool,
    /// Half of how far the camera moves to the side, and half of how far it turns.
    pub shift_m: f64,
    pub turn_rad: f64,
    /// Until it is back.
    pub period_frames: f64,
    /// Of both shutters, seconds.
    pub readout_secs: f64,
}

pub fn camera() -> Camera {
    let intrinsics = Intrinsics {
        fx: 165.0,
        fy: 165.0,
        cx: 99.5,
        cy: 74.5,
    };
    Camera::new(200, 150, intrinsics).unwrap()
}

impl Posters {
    /// To and fro along the wall, starting from rest, and a third of that up and down.
    fn pose(&self, secs: f64) -> Se3 {
        let phase = std::f64::consts::TAU * secs * FRAMES_PER_SEC / self.period_frames;
        let (across, along) = (1.0 - phase.cos(), 0.3 * (1.0 - (2.0 * phase).cos()));
        let position = self.shift_m * Vector3::new(across, along, 0.0);
        let turn = self.turn_rad * Vector3::new(along, across, 0.0);
        Se3::new(UnitQuaternion::from_scaled_axis(turn), position)
    }

    /// Depth of what a ray hits, its z being 1 in the camera's axes.
    fn depth_m(&self, from: &Vector3<f64>, ray: &Vector3<f64>) -> f64 {
        let wall = (1.5 - from.z) / ray.z;
        let beside = [(0.6 - from.y) / ray.y, (0.9 - from.x) / ray.x];
        let nearer = beside
            .into_iter()
            .filter(|depth| self.corner && *depth > 0.0);
        nearer.fold(wall, f64::min)
    }

    /// What a Kinect sees: noise of 3 mm at 1.5 m, and of a step and a half of colour.
    pub fn frame(&self, index: usize) -> RgbdFrame {
        let (camera, secs) = (camera(), index as f64 / FRAMES_PER_SEC);
        let mut rng = Pcg64Mcg::seed_from_u64(index as u64);
        let mut normal = || (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>();
        let poses: Vec<Se3> = (0..camera.height)
            .map(|v| self.pose(secs + row_delay_secs(v, camera.height, self.readout_secs)))
            .collect();
        let mut depth_m = Image::filled(camera.width, camera.height, 0.0);
        let color = Image::from_fn(camera.width, camera.height, |u, v| {
            let from = &poses[v].translation;
            let ray = poses[v].rotation * camera.ray(u as f64, v as f64);
            let depth = self.depth_m(from, &ray);
            let point = from + depth * ray;
            depth_m.set(u, v, (depth + 0.003 * normal()) as f32);
            let level = 255.0 * poster(point.x + point.z, point.y + point.z) + 1.5 * normal();
            [level.round().clamp(0.0, 255.0) as u8; 3]
        });
        RgbdFrame::new(FrameIndex(index), secs, color, depth_m, camera).unwrap()
    }

    /// Root mean square of the position's error over so many frames, the first pose being right,
    /// metres; infinite if a frame is lost. Frames say that their shutters take `given_secs`.
    pub fn error_m(&self, frames: usize, color: bool, given_secs: f64) -> f64 {
        let mut config = SlamConfig::default();
        config.tracking.color = color;
        config.tracking.grid_stride_px = Some(2);
        config.mapping.iterations_per_frame = 0.1;
        let model = CpuModel::new(model_settings(&config.mapping));
        let mut slam = Slam::new(&camera(), &config, Execution::Lockstep, Box::new(model)).unwrap();
        for index in 0..frames {
            let mut frame = self.frame(index);
            frame.color_readout_secs = given_secs;
            frame.depth_sensor = DepthSensor {
                readout_secs: given_secs,
                ..DepthSensor::default()
            };
            slam.push(frame).unwrap();
        }
        let first_from_world = self.pose(0.0).inverse();
        let squared = slam.finish().frames.into_iter().map(|frame| {
            let truth = first_from_world * self.pose(frame.timestamp_secs.unwrap());
            let found = frame.world_from_camera.map(|pose| pose.translation);
            found.map_or(f64::INFINITY, |found| {
                (found - truth.translation).norm_squared()
            })
        });
        (squared.sum::<f64>() / frames as f64).sqrt()
    }
}

/// Sheets of 12 cm by 9 cm in shades of grey, with lines of print.
fn poster(x: f64, y: f64) -> f64 {
    let (column, row) = ((x / 0.12).floor(), (y / 0.09).floor());
    let mixed = (column * 12.9898 + row * 78.233).sin() * 43758.5453;
    let shade = 0.25 + 0.5 * (mixed - mixed.floor());
    let print = (x / 0.018).sin() * (y / 0.013).sin();
    shade + 0.12 * print
}
