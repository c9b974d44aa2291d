//! A room corner with a smooth random texture, for tests.

use fgs_geom::{Camera, FrameIndex, Image, Intrinsics, RgbdFrame, Se3};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::IntensityImage;

pub fn rng(seed: u64) -> Pcg64Mcg {
    Pcg64Mcg::seed_from_u64(seed)
}

/// A small camera.
pub fn camera() -> Camera {
    let intrinsics = Intrinsics {
        fx: 40.0,
        fy: 41.0,
        cx: 15.2,
        cy: 11.7,
    };
    Camera::new(32, 24, intrinsics).unwrap()
}

/// Brightness values as an image of the small camera.
pub fn image_of(pixels: &Image<f32>) -> IntensityImage {
    let seen = pixels.map(|_| true);
    IntensityImage::of_render(camera(), &pixels.map(|p| [*p; 3]), &seen)
}

/// A textured wall at z = 2 m, or a corner if `with_floor`.
pub struct Scene {
    waves: Vec<[f64; 4]>,
    pub with_floor: bool,
}

impl Scene {
    pub fn new(seed: u64, with_floor: bool) -> Self {
        let mut rng = rng(seed);
        let mut wave = || {
            let mut number = |low, high| rng.random_range(low..high);
            [
                number(-25.0, 25.0),
                number(-25.0, 25.0),
                number(0.0, 6.3),
                number(0.02, 0.07),
            ]
        };
        Self {
            waves: (0..12).map(|_| wave()).collect(),
            with_floor,
        }
    }

    /// A frame at a pose, with colours `gain * texture + offset`.
    pub fn frame(&self, pose: &Se3, gain: f64, offset: f64) -> RgbdFrame {
        let intrinsics = Intrinsics {
            fx: 130.0,
            fy: 131.0,
            cx: 79.0,
            cy: 61.5,
        };
        let camera = Camera::new(160, 120, intrinsics).unwrap();
        let mut color = Image::filled(160, 120, [0; 3]);
        let mut depth_m = Image::filled(160, 120, 0.0);
        for v in 0..120 {
            for u in 0..160 {
                let ray = pose.rotation * camera.ray(u as f64, v as f64);
                let eye = pose.translation;
                let mut depth = (2.0 - eye.z) / ray.z;
                let to_floor = (0.6 - eye.y) / ray.y;
                if self.with_floor && to_floor > 0.0 && to_floor < depth {
                    depth = to_floor;
                }
                let level = gain * self.paint(&(eye + depth * ray)) + offset;
                color.set(u, v, [(255.0 * level).round().clamp(0.0, 255.0) as u8; 3]);
                depth_m.set(u, v, depth as f32);
            }
        }
        RgbdFrame::new(FrameIndex(0), 0.0, color, depth_m, camera).unwrap()
    }

    fn paint(&self, at: &Vector3<f64>) -> f64 {
        let waves = self.waves.iter();
        0.5 + waves
            .map(|[a, b, phase, height]| height * (a * at.x + b * (at.y + at.z) + phase).sin())
            .sum::<f64>()
    }
}
