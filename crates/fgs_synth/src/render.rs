//! Pictures of a room: exact depth at pixel centres and anti-aliased linear colour.
//!
//! Each pixel averages its centre and its four corners (shared with its neighbours); where these
//! disagree, 3x3 samples instead. Every pixel is a function of the scene alone, so any number of
//! threads gives the same picture.

use fgs_geom::{Camera, Image, View};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use crate::pattern::Rgb;
use crate::room::{Hit, Room};
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
    /// The ray through a point of the image: z = 1 in camera axes, so that t is depth.
    fn ray(&self, u: f64, v: f64) -> Ray {
        Ray {
            origin: self.origin,
            direction: self.world_from_camera * self.camera.ray(u, v),
        }
    }

    fn shade(&self, ray: &Ray, hit: &Hit) -> Rgb {
        (self.room).radiance(ray, hit, 1.0 / self.camera.intrinsics.fx)
    }

    /// What is seen at a point of the image. `likely` is the solid seen nearby.
    fn sample(&self, u: f64, v: f64, likely: Option<usize>) -> Sample {
        let ray = self.ray(u, v);
        match self.room.meet(&ray, likely) {
            Some(hit) => Sample {
                radiance: self.shade(&ray, &hit),
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

    /// Radiance at a point of the image where `solid` is known to be in front.
    fn sample_solid(&self, u: f64, v: f64, solid: usize) -> Option<Rgb> {
        let ray = self.ray(u, v);
        let (t, face) = self.room.solids[solid].meet(&ray, 0.0, f64::INFINITY)?;
        Some(self.shade(&ray, &Hit { t, solid, face }))
    }

    fn row(&self, width: usize, v: f64, left: f64) -> Vec<Sample> {
        let mut likely = None;
        (0..width)
            .map(|u| {
                let sample = self.sample(u as f64 + left, v, likely);
                likely = sample.met.map(|(solid, _)| solid);
                sample
            })
            .collect()
    }

    /// The mean of 3x3 samples about a pixel's centre, which is one of them. With one face in all
    /// of the pixel only its pattern varies, and nothing else needs to be looked for.
    fn finely(&self, u: usize, v: usize, center: &Sample, is_one_face: bool) -> Rgb {
        let solid = center.met.map(|(solid, _)| solid);
        let mut sum = center.radiance;
        for i in (0..9).filter(|&i| i != 4) {
            let u = u as f64 + f64::from(i % 3 - 1) / 3.0;
            let v = v as f64 + f64::from(i / 3 - 1) / 3.0;
            let known = solid.filter(|_| is_one_face);
            sum += (known.and_then(|solid| self.sample_solid(u, v, solid)))
                .unwrap_or_else(|| self.sample(u, v, solid).radiance);
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
                let is_one_face = around.iter().all(|corner| corner.met == center.met);
                let is_even = is_one_face && around.iter().all(|corner| is_close(center, corner));
                radiance[u] = if is_even || sampling == Sampling::Fast {
                    let sum: Rgb = around.iter().map(|corner| corner.radiance).sum();
                    0.5 * center.radiance + 0.125 * sum
                } else {
                    tracer.finely(u, v, center, is_one_face)
                };
            }
        });
    Picture { radiance, depth_m }
}

fn is_close(a: &Sample, b: &Sample) -> bool {
    let difference = (a.radiance - b.radiance).abs();
    let allowed = (a.radiance.sup(&b.radiance) * CONTRAST).add_scalar(CONTRAST * DARK);
    (allowed - difference).min() >= 0.0
}
