//! Whether depth is measured along the camera's axis, as it must be, or is the distance from the camera,
//! as lasers and some renderers give it.
//!
//! Along the axis a plane's inverse depth is a linear function of the pixel; inverse distance is that
//! function divided by the length of the pixel's ray. Windows of each frame are fitted by
//! `(a + b u + c v) (ray length)^-x`: x is 0 for depth and 1 for distance.

use fgs_geom::{Camera, Image, has_depth};
use nalgebra::{Matrix4, Vector4};

use super::report::Check;
use super::statistics::median;

const NAME: &str = "depth along z";

/// So many windows side by side: large, as a ray's length hardly changes within a small one.
const WINDOWS: usize = 5;

/// Pixels taken from a window's side.
const SAMPLES: usize = 24;

/// Of a window's pixels, so many must have depth.
const MIN_SHARE: f64 = 0.8;

/// A window is no plane if its depths differ from one by more.
const MAX_RESIDUAL: f64 = 0.01;

/// A window tells nothing if its exponent has a larger standard error.
const MAX_ERROR: f64 = 1.0;

/// With fewer windows nothing can be said.
const MIN_WINDOWS: usize = 20;

/// Lens distortion and noise move the exponent by a fraction of this.
const LIMIT: f64 = 0.5;

/// Collects the exponents of windows.
#[derive(Default)]
pub struct FlatnessWatch {
    exponents: Vec<f64>,
}

impl FlatnessWatch {
    /// Adds a frame.
    pub fn add(&mut self, depth_m: &Image<f32>, camera: &Camera) {
        let size = [depth_m.width() / WINDOWS, depth_m.height() / WINDOWS];
        if size.iter().any(|side| *side < SAMPLES) {
            return;
        }
        // Overlapping by half.
        for row in 0..2 * WINDOWS - 1 {
            for column in 0..2 * WINDOWS - 1 {
                let corner = [column * size[0] / 2, row * size[1] / 2];
                self.exponents
                    .extend(exponent(depth_m, camera, corner, size));
            }
        }
    }

    /// The verdict over all frames.
    pub fn check(&self) -> Check {
        if self.exponents.len() < MIN_WINDOWS {
            return Check::unknown(NAME, "too few flat surfaces to tell".into());
        }
        let Some(exponent) = median(self.exponents.clone()) else {
            return Check::unknown(NAME, "too few flat surfaces to tell".into());
        };
        if exponent < LIMIT {
            return Check::ok(NAME, "flat surfaces are flat".into());
        }
        let seen = "flat surfaces are flat only if depth is the distance from the camera, not the depth \
                    along its axis";
        let advice =
            "divide the depth of pixel (u, v) by sqrt(1 + ((u - cx) / fx)^2 + ((v - cy) / fy)^2)";
        Check::problem(NAME, seen.into(), advice.into())
    }
}

/// The exponent of a window, if it is a plane and shows it.
fn exponent(
    depth_m: &Image<f32>,
    camera: &Camera,
    [left, top]: [usize; 2],
    [width, height]: [usize; 2],
) -> Option<f64> {
    let mut points = Vec::with_capacity(SAMPLES * SAMPLES);
    for i in 0..SAMPLES {
        for j in 0..SAMPLES {
            let (u, v) = (left + j * width / SAMPLES, top + i * height / SAMPLES);
            let depth = depth_m.at(u, v);
            if has_depth(depth) {
                let x = (u - left) as f64 / width as f64 - 0.5;
                let y = (v - top) as f64 / height as f64 - 0.5;
                let ray_length = camera.ray(u as f64, v as f64).norm();
                points.push((x, y, -ray_length.ln(), 1.0 / f64::from(depth)));
            }
        }
    }
    if (points.len() as f64) < MIN_SHARE * (SAMPLES * SAMPLES) as f64 {
        return None;
    }
    let mean = points.iter().map(|point| point.3).sum::<f64>() / points.len() as f64;
    // (a + b x + c y) (ray length)^-e is about a + b x + c y + e ln(1 / ray length) of the plane; two
    // rounds are enough.
    let mut plane = Vector4::new(1.0, 0.0, 0.0, 0.0);
    let mut error = f64::INFINITY;
    for _ in 0..2 {
        let mut hessian = Matrix4::zeros();
        let mut gradient = Vector4::zeros();
        let row = |x: f64, y: f64, log: f64| {
            Vector4::new(1.0, x, y, (plane[0] + plane[1] * x + plane[2] * y) * log)
        };
        for &(x, y, log, inverse) in &points {
            let row = row(x, y, log);
            hessian += row * row.transpose();
            gradient += row * (inverse / mean);
        }
        let covariance = hessian.cholesky()?.inverse();
        let solution = covariance * gradient;
        let squares = points.iter().map(|&(x, y, log, inverse)| {
            let residual: f64 = row(x, y, log).dot(&solution) - inverse / mean;
            residual.powi(2)
        });
        let variance = squares.sum::<f64>() / points.len() as f64;
        if variance.sqrt() > MAX_RESIDUAL {
            return None;
        }
        error = (variance * covariance[(3, 3)]).sqrt();
        plane = solution;
    }
    (error <= MAX_ERROR && plane[3].is_finite()).then_some(plane[3])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::report::Verdict;
    use crate::doctor::test_room;

    #[test]
    fn distance_is_told_from_depth() {
        let camera = test_room::camera();
        let check = |factor: &dyn Fn(usize, usize) -> f32| {
            let mut watch = FlatnessWatch::default();
            for i in 0..5 {
                let depth_m = test_room::frame(10 * i).depth_m;
                let seen = Image::from_fn(camera.width, camera.height, |u, v| {
                    depth_m.at(u, v) * factor(u, v)
                });
                watch.add(&seen, &camera);
            }
            watch.check().verdict
        };
        assert_eq!(check(&|_, _| 1.0), Verdict::Ok);
        let ray = |u: usize, v: usize| camera.ray(u as f64, v as f64).norm() as f32;
        assert_eq!(check(&ray), Verdict::Problem);
        assert_eq!(check(&|_, _| 0.0), Verdict::Unknown);
    }
}
