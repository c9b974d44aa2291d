//! Pictures of a room: exact depth at pixel centres and anti-aliased linear colour.
//!
//! Each pixel averages its centre and its four corners (shared with its neighbours); where these
//! disagree, 3x3 samples instead. Every pixel is a function of the scene alone, so any number of
//! threads gives the same picture.

use fgs_geom::{Camera, Image, View};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use crate::pattern::Rgb;
use crate::room::Room;
use crate::shape::Ray;

/// Relative difference of samples of a channel above which a pixel is sampled more finely: less
/// would not be seen after averaging five.
const CONTRAST: f32 = 0.1;
/// Darkness below which differences do not matter: two 8-bit steps near black.
const DARK: f32 = 0.02;

/// How finely colour is sampled.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Sampling {
    /// Five samples a pixel, nine more where they disagree.
    Fine,
    /// Five samples a pixel: enough where pictures are averaged over a camera's motion.
    Fast,
}

/// Linear radiance and depth.
pub(crate) struct Picture {
    pub radiance: Image<Rgb>,
    /// Depth along z, metres; 0: nothing met.
    pub depth_m: Image<f32>,
}

#[derive(Clone, Copy)]
struct Sample {
    radiance: Rgb,
    depth: f64,
    /// Solid and face, `None` for nothing.
    met: Option<(usize, usize)>,
}

struct Tracer<'a> {
    room: &'a Room,
    camera: Camera,
    origin: Vector3<f64>,
    world_from_camera: Matrix3<f64>,
}

impl Tracer<'_> {
    /// What is seen at a point of the image. `likely` is the solid seen nearby.
    fn sample(&self, u: f64, v: f64, likely: Option<(usize, usize)>) -> Sample {
        // z = 1 in camera axes, so that distance along the ray is depth.
        let ray = Ray {
            origin: self.origin,
            direction: self.world_from_camera * self.camera.ray(u, v),
        };
        match self.room.meet(&ray, likely.map(|(solid, _)| solid)) {
            Some(hit) => Sample {
                radiance: (self.room).radiance(&ray, &hit, 1.0 / self.camera.intrinsics.fx),
                depth: hit.t,
                met: Some((hit.solid, hit.face)),
            },
            None => Sample {
                radiance: Rgb::zeros(),
                depth: 0.0,
                met: None,
            },
        }
    }

    fn row(&self, width: usize, v: f64, left: f64) -> Vec<Sample> {
        let mut likely = None;
        (0..width)
            .map(|u| {
                let sample = self.sample(u as f64 + left, v, likely);
                likely = sample.met;
                sample
            })
            .collect()
    }

    /// The mean of 3x3 samples about a pixel's centre, which is one of them.
    fn finely(&self, u: usize, v: usize, center: &Sample) -> Rgb {
        let mut sum = center.radiance;
        for i in (0..9).filter(|&i| i != 4) {
            let du = f64::from(i % 3 - 1) / 3.0;
            let dv = f64::from(i / 3 - 1) / 3.0;
            sum += self
                .sample(u as f64 + du, v as f64 + dv, center.met)
                .radiance;
        }
        sum / 9.0
    }
}

/// The room seen from a view.
pub(crate) fn render(room: &Room, view: &View, sampling: Sampling) -> Picture {
    let Camera { width, height, .. } = view.camera;
    let tracer = Tracer {
        room,
        camera: view.camera,
        origin: view.world_from_camera.translation,
        world_from_camera: view
            .world_from_camera
            .rotation
            .to_rotation_matrix()
            .into_inner(),
    };
    let corners: Vec<Vec<Sample>> = (0..height + 1)
        .into_par_iter()
        .map(|v| tracer.row(width + 1, v as f64 - 0.5, -0.5))
        .collect();
    let mut radiance = Image::filled(width, height, Rgb::zeros());
    let mut depth_m = Image::filled(width, height, 0.0);
    (radiance.data_mut().par_chunks_mut(width))
        .zip(depth_m.data_mut().par_chunks_mut(width))
        .enumerate()
        .for_each(|(v, (radiance, depth_m))| {
            let centers = tracer.row(width, v as f64, 0.0);
            for (u, center) in centers.iter().enumerate() {
                let around = [
                    &corners[v][u],
                    &corners[v][u + 1],
                    &corners[v + 1][u],
                    &corners[v + 1][u + 1],
                ];
                depth_m[u] = center.depth as f32;
                let alike = around.iter().all(|corner| agree(center, corner));
                radiance[u] = if alike || sampling == Sampling::Fast {
                    let sum: Rgb = around.iter().map(|corner| corner.radiance).sum();
                    0.5 * center.radiance + 0.125 * sum
                } else {
                    tracer.finely(u, v, center)
                };
            }
        });
    Picture { radiance, depth_m }
}

fn agree(a: &Sample, b: &Sample) -> bool {
    let difference = (a.radiance - b.radiance).abs();
    let allowed = (a.radiance.sup(&b.radiance) * CONTRAST).add_scalar(CONTRAST * DARK);
    a.met == b.met && difference <= allowed
}
