//! Sensor model, applied to a rendered image: noise, disparity quantisation and holes in depth;
//! exposure, tone curve and noise in colour.
//!
//! Every row of every frame has its own random generator, so results are reproducible with any
//! number of threads.

use std::f64::consts::TAU;

use fgs_geom::{Camera, Image, has_depth};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use crate::noise::{unit, value_noise};
use crate::pattern::Rgb;

/// The imperfections of an RGB-D camera. Each can be turned off independently.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorModel {
    /// Axial depth noise (along z) as a multiple of a Kinect's, whose standard deviation is
    /// 1.2 mm + 1.9 mm/m^2 (z - 0.4 m)^2 (Nguyen, Izadi and Lovell 2012). 0: none.
    pub depth_noise: f64,
    /// Standard deviation of the lateral noise, in pixels of an image 640 pixels wide. Depth is
    /// sampled at a pixel moved by it, which frays the edges of objects. 0: none.
    pub edge_jitter_px: f64,
    /// Depth resolution: depth is quantised in equal steps of disparity, which makes the depth
    /// step this times z^2; metres per square metre. 0: no quantisation.
    pub depth_step_per_m: f64,
    /// Working range: nearest and farthest depth measured, metres.
    pub range_m: [f64; 2],
    /// Whether depth is missing at object edges, on surfaces at a grazing angle and in random
    /// patches.
    pub holes: bool,
    /// Amplitude of the slow drift of exposure, as a natural logarithm: 0.1 is about 10 % either
    /// way. White balance drifts by a sixth of it. 0: constant.
    pub exposure_drift: f64,
    /// Standard deviation of colour noise, in 8-bit steps (1/255). 0: none.
    pub color_noise: f64,
    /// Exposure time as a fraction of the frame interval. 0: no motion blur.
    pub shutter: f64,
}

impl SensorModel {
    /// No imperfections: depth is exact to `f32`.
    pub fn exact() -> Self {
        Self {
            depth_noise: 0.0,
            edge_jitter_px: 0.0,
            depth_step_per_m: 0.0,
            range_m: [0.0, f64::INFINITY],
            holes: false,
            exposure_drift: 0.0,
            color_noise: 0.0,
            shutter: 0.0,
        }
    }

    /// A first-generation Kinect, hand-held indoors.
    pub fn kinect() -> Self {
        Self {
            depth_noise: 1.0,
            edge_jitter_px: 0.6,
            // A disparity step of an eighth of a pixel at a focal length of 580 px and a baseline
            // of 75 mm.
            depth_step_per_m: 0.125 / (580.0 * 0.075),
            range_m: [0.4, 5.0],
            holes: true,
            exposure_drift: 0.08,
            color_noise: 1.5,
            // An exposure of 8 ms of the 33 ms between frames.
            shutter: 0.25,
        }
    }

    /// The depth image that the sensor measures, metres; 0 where it has no depth.
    pub(crate) fn measure(
        &self,
        exact: &Image<f32>,
        camera: &Camera,
        seed: u64,
        frame: usize,
    ) -> Image<f32> {
        let mut measured = exact.clone();
        if !self.spoils_depth() {
            return measured;
        }
        let width = exact.width();
        (measured.data_mut().par_chunks_mut(width.max(1)))
            .enumerate()
            .for_each(|(v, row)| {
                let mut rng = row_rng(seed, frame, v, 0);
                for (u, depth) in row.iter_mut().enumerate() {
                    *depth = self.measure_pixel(exact, camera, [u, v], frame, &mut rng);
                }
            });
        measured
    }

    fn spoils_depth(&self) -> bool {
        let exact = Self::exact();
        self.depth_noise != exact.depth_noise
            || self.edge_jitter_px != exact.edge_jitter_px
            || self.depth_step_per_m != exact.depth_step_per_m
            || self.range_m != exact.range_m
            || self.holes
    }

    fn measure_pixel(
        &self,
        exact: &Image<f32>,
        camera: &Camera,
        [u, v]: [usize; 2],
        frame: usize,
        rng: &mut Pcg64Mcg,
    ) -> f32 {
        let scale = camera.width as f64 / 640.0;
        let mut jitter = |x: usize, size: usize| {
            let moved = x as f64 + self.edge_jitter_px * scale * gaussian(rng);
            (moved.round().max(0.0) as usize).min(size - 1)
        };
        let (near_u, near_v) = (jitter(u, camera.width), jitter(v, camera.height));
        let exact_here = exact.at(near_u, near_v);
        let z = f64::from(exact_here);
        let sigma = self.depth_noise * (0.0012 + 0.0019 * (z - 0.4).powi(2));
        let noisy = z + sigma * gaussian(rng);
        // Beyond an angle of incidence of 75 to 82 degrees too little light returns to the sensor.
        let steepest = rng.random_range(3.7..7.0);
        let is_hole = !has_depth(exact_here)
            || self.holes
                && (slope(exact, camera, [near_u, near_v]) > steepest
                    || blotched(u as f64 / scale, v as f64 / scale, frame));
        if is_hole || noisy <= 0.0 || !(self.range_m[0]..=self.range_m[1]).contains(&noisy) {
            return 0.0;
        }
        if self.depth_noise == 0.0 && self.depth_step_per_m == 0.0 {
            return exact_here;
        }
        (if self.depth_step_per_m > 0.0 {
            let disparity = (1.0 / (self.depth_step_per_m * noisy)).round().max(1.0);
            1.0 / (self.depth_step_per_m * disparity)
        } else {
            noisy
        }) as f32
    }

    /// The 8-bit sRGB image of linear radiance.
    pub(crate) fn develop(&self, radiance: &Image<Rgb>, seed: u64, frame: usize) -> Image<[u8; 3]> {
        let width = radiance.width();
        let gains = self.gains(seed, frame);
        let mut color = Image::filled(width, radiance.height(), [0; 3]);
        (color.data_mut().par_chunks_mut(width.max(1)))
            .enumerate()
            .for_each(|(v, row)| {
                let mut rng = row_rng(seed, frame, v, 1);
                for (pixel, radiance) in row.iter_mut().zip(radiance.row(v)) {
                    let linear = radiance.component_mul(&gains);
                    *pixel = std::array::from_fn(|channel| {
                        let mut code = 255.0 * srgb_code(tone(linear[channel]));
                        if self.color_noise > 0.0 {
                            code += (self.color_noise * gaussian(&mut rng)) as f32;
                        }
                        code.round() as u8
                    });
                }
            });
        color
    }

    /// Gain of each channel: exposure drifts slowly, white balance by a sixth of that.
    fn gains(&self, seed: u64, frame: usize) -> Rgb {
        let secs = frame as f64 / crate::FRAMES_PER_SECOND;
        let wave = |k: i32, period: f64| {
            let start = f64::from(unit(k, 3, seed as u32));
            (TAU * (secs / period + start)).sin()
        };
        let exposure = 0.6 * wave(0, 7.3) + 0.4 * wave(1, 2.9);
        Rgb::from_fn(|channel, _| {
            let balance = wave(2 + channel as i32, 5.1) / 6.0;
            (self.exposure_drift * (exposure + balance)).exp() as f32
        })
    }
}

fn row_rng(seed: u64, frame: usize, row: usize, stream: u64) -> Pcg64Mcg {
    let place = (frame as u64) << 24 | (row as u64) << 1 | stream;
    // Multiplication by an odd factor is invertible, so different rows get different seeds.
    Pcg64Mcg::seed_from_u64(seed ^ place.wrapping_mul(0x9E37_79B9_7F4A_7C15))
}

/// A standard normal sample, by the Box-Muller transform.
fn gaussian(rng: &mut Pcg64Mcg) -> f64 {
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    radius * (TAU * rng.random::<f64>()).cos()
}

/// The tangent of the angle of incidence (between surface normal and line of sight), from central
/// differences; large at depth edges too.
fn slope(depth: &Image<f32>, camera: &Camera, [u, v]: [usize; 2]) -> f64 {
    let at = |u: usize, v: usize| f64::from(depth.at(u, v));
    let last = |size: usize| size - 1;
    let across = at((u + 1).min(last(camera.width)), v) - at(u.saturating_sub(1), v);
    let down = at(u, (v + 1).min(last(camera.height))) - at(u, v.saturating_sub(1));
    0.5 * across.hypot(down) * camera.intrinsics.fx / at(u, v)
}

/// Whether a pixel lies in a random patch without depth. They cover about 1 % of the image and
/// change with every frame.
fn blotched(u: f64, v: f64, frame: usize) -> bool {
    value_noise(u as f32 / 18.0, v as f32 / 14.0, frame as u32) > 0.88
}

/// Extended Reinhard tone curve after a fixed gain: nearly linear in the shadows, and white where
/// the amplified radiance reaches 4.
fn tone(linear: f32) -> f32 {
    const GAIN: f32 = 1.5;
    const WHITE: f32 = 4.0;
    let x = GAIN * linear;
    (x * (1.0 + x / (WHITE * WHITE)) / (1.0 + x)).clamp(0.0, 1.0)
}

fn srgb_code(linear: f32) -> f32 {
    if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::KINECT;

    fn wall(depth: f32) -> Image<f32> {
        Image::filled(KINECT.width, KINECT.height, depth)
    }

    fn spread(image: &Image<f32>) -> (f64, f64) {
        let valid: Vec<f64> = (image.data().iter().filter(|d| has_depth(**d)))
            .map(|d| f64::from(*d))
            .collect();
        let mean = valid.iter().sum::<f64>() / valid.len() as f64;
        let variance = valid.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / valid.len() as f64;
        (mean, variance.sqrt())
    }

    #[test]
    fn an_exact_sensor_changes_nothing_and_range_alone_keeps_the_rest() {
        let depth = Image::from_fn(640, 480, |u, v| 0.1 + (u + v) as f32 * 1e-3);
        assert_eq!(SensorModel::exact().measure(&depth, &KINECT, 1, 2), depth);
        let cut = SensorModel {
            range_m: [0.3, 0.9],
            ..SensorModel::exact()
        };
        let expected = depth.map(|d| if (0.3..=0.9).contains(d) { *d } else { 0.0 });
        assert_eq!(cut.measure(&depth, &KINECT, 1, 2), expected);
    }

    #[test]
    fn depth_noise_has_the_stated_spread() {
        let sensor = SensorModel {
            depth_noise: 1.0,
            ..SensorModel::exact()
        };
        for (z, sigma) in [(1.0, 0.0012 + 0.0019 * 0.36), (3.0, 0.0012 + 0.0019 * 6.76)] {
            let (mean, spread) = spread(&sensor.measure(&wall(z as f32), &KINECT, 1, 2));
            assert!((mean - z).abs() <= 0.05 * sigma);
            assert!((spread - sigma).abs() <= 0.02 * sigma, "{spread} {sigma}");
        }
    }

    #[test]
    fn depth_comes_in_steps_that_grow_with_its_square() {
        let sensor = SensorModel {
            depth_noise: 0.0,
            ..SensorModel::kinect()
        };
        let ramp = Image::from_fn(640, 480, |u, _| 1.9 + 0.2 * u as f32 / 640.0);
        let measured = sensor.measure(&ramp, &KINECT, 1, 2);
        let mut levels: Vec<f32> = measured
            .data()
            .iter()
            .copied()
            .filter(|d| *d > 0.0)
            .collect();
        levels.sort_by(f32::total_cmp);
        levels.dedup();
        let step = f64::from(levels[levels.len() - 1] - levels[0]) / (levels.len() - 1) as f64;
        assert!((step - 2.87e-3 * 4.0).abs() <= 0.05 * step, "{step}");
    }

    #[test]
    fn range_edges_and_grazing_surfaces_have_no_depth() {
        let kinect = SensorModel::kinect();
        for outside in [0.3, 6.0] {
            let measured = kinect.measure(&wall(outside), &KINECT, 1, 2);
            assert!(measured.data().iter().all(|d| *d == 0.0));
        }
        let share = |depth: &Image<f32>, columns: std::ops::Range<usize>| {
            let measured = kinect.measure(depth, &KINECT, 1, 2);
            let total = columns.len() * 480;
            let valid = columns.flat_map(|u| (0..480).map(move |v| (u, v)));
            valid.filter(|&(u, v)| measured.at(u, v) > 0.0).count() as f64 / total as f64
        };
        let edge = Image::from_fn(640, 480, |u, _| if u < 320 { 1.0 } else { 2.0 });
        assert!(share(&edge, 319..321) <= 0.3);
        assert!(share(&edge, 0..300) >= 0.97);
        assert!(share(&edge, 0..300) <= 0.998, "blotches");
        // 85 degrees: from pixel to pixel z grows by the fraction tan(85 degrees) / fx.
        let steep = Image::from_fn(640, 480, |_, v| (11.43 * v as f32 / 525.0).exp().min(4.0));
        let measured = kinect.measure(&steep, &KINECT, 1, 2);
        assert!((5..50).all(|v| (0..640).all(|u| measured.at(u, v) == 0.0)));
    }

    #[test]
    fn exposure_wanders_and_colour_noise_has_the_stated_spread() {
        let grey = Image::filled(64, 48, Rgb::repeat(0.3));
        let level = |image: &Image<[u8; 3]>| {
            let sum: f64 = image.data().iter().map(|p| f64::from(p[1])).sum();
            sum / image.data().len() as f64
        };
        let exact = SensorModel::exact();
        assert_eq!(exact.develop(&grey, 1, 0), exact.develop(&grey, 1, 77));
        let kinect = SensorModel::kinect();
        let levels: Vec<f64> = (0..300)
            .map(|i| level(&kinect.develop(&grey, 1, i)))
            .collect();
        let range = levels
            .iter()
            .fold((f64::MAX, f64::MIN), |r, l| (r.0.min(*l), r.1.max(*l)));
        assert!((4.0..25.0).contains(&(range.1 - range.0)), "{range:?}");
        assert!(
            levels
                .windows(2)
                .all(|pair| (pair[1] - pair[0]).abs() <= 1.0)
        );
        let noisy = kinect.develop(&grey, 1, 0);
        let mean = level(&noisy);
        let square = |p: &[u8; 3]| (f64::from(p[1]) - mean).powi(2);
        let spread = (noisy.data().iter().map(square).sum::<f64>() / (64.0 * 48.0)).sqrt();
        assert!((spread - 1.5).abs() <= 0.1, "{spread}");
    }
}
