//! Pictures of a room: exact depth at pixel centres and anti-aliased linear colour.
//!
//! Each pixel averages its centre and its four corners (shared with its neighbours) and, where
//! these disagree, the middles of its sides. Every pixel is a function of the scene alone, so any
//! number of threads gives the same picture.

use fgs_geom::{Camera, Image, Se3, View};
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

/// Linear radiance and depth.
pub(crate) struct Picture {
    pub radiance: Image<Rgb>,
    /// Depth along z, metres; 0: nothing met.
    pub depth_m: Image<f32>,
}

impl Picture {
    fn black(camera: &Camera) -> Self {
        Self {
            radiance: Image::filled(camera.width, camera.height, Rgb::zeros()),
            depth_m: Image::filled(camera.width, camera.height, 0.0),
        }
    }

    /// Calls `fill` with each row's number, radiance and depth.
    fn for_each_row(&mut self, fill: impl Fn(usize, &mut [Rgb], &mut [f32]) + Sync) {
        let width = self.radiance.width();
        (self.radiance.data_mut().par_chunks_mut(width))
            .zip(self.depth_m.data_mut().par_chunks_mut(width))
            .enumerate()
            .for_each(|(v, (radiance, depth_m))| fill(v, radiance, depth_m));
    }
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

impl<'a> Tracer<'a> {
    fn new(room: &'a Room, view: &View) -> Self {
        let rotation = view.world_from_camera.rotation.to_rotation_matrix();
        Self {
            room,
            camera: view.camera,
            origin: view.world_from_camera.translation,
            world_from_camera: rotation.into_inner(),
        }
    }

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

    /// Samples one pixel apart, the first at [u, v].
    fn row(&self, width: usize, [left, v]: [f64; 2]) -> Vec<Sample> {
        let mut likely = None;
        (0..width)
            .map(|u| {
                let sample = self.sample(u as f64 + left, v, likely);
                likely = sample.met.map(|(solid, _)| solid);
                sample
            })
            .collect()
    }

    /// The sum of radiance at the middles of a pixel's sides. With one face in all of the pixel
    /// only its pattern varies, and nothing else needs to be looked for.
    fn sides(&self, u: usize, v: usize, center: &Sample, is_one_face: bool) -> Rgb {
        let solid = center.met.map(|(solid, _)| solid);
        [(-0.5, 0.0), (0.5, 0.0), (0.0, -0.5), (0.0, 0.5)]
            .map(|(du, dv)| {
                let (u, v) = (u as f64 + du, v as f64 + dv);
                let known = solid.filter(|_| is_one_face);
                (known.and_then(|solid| self.sample_solid(u, v, solid)))
                    .unwrap_or_else(|| self.sample(u, v, solid).radiance)
            })
            .iter()
            .sum()
    }
}

/// The room seen from a view.
pub(crate) fn render(room: &Room, view: &View) -> Picture {
    let Camera { width, height, .. } = view.camera;
    let tracer = Tracer::new(room, view);
    let corners: Vec<Vec<Sample>> = (0..height + 1)
        .into_par_iter()
        .map(|v| tracer.row(width + 1, [-0.5, v as f64 - 0.5]))
        .collect();
    let mut picture = Picture::black(&view.camera);
    picture.for_each_row(|v, radiance, depth_m| {
        let centers = tracer.row(width, [0.0, v as f64]);
        for (u, center) in centers.iter().enumerate() {
            let around = [
                &corners[v][u],
                &corners[v][u + 1],
                &corners[v + 1][u],
                &corners[v + 1][u + 1],
            ];
            let is_one_face = around.iter().all(|corner| corner.met == center.met);
            let is_even = is_one_face && around.iter().all(|corner| is_close(center, corner));
            let sum: Rgb = around.iter().map(|corner| corner.radiance).sum();
            depth_m[u] = center.depth as f32;
            // Weights of a tent over the pixel.
            radiance[u] = if is_even {
                0.5 * center.radiance + 0.125 * sum
            } else {
                let sides = tracer.sides(u, v, center, is_one_face);
                0.25 * center.radiance + 0.125 * sides + 0.0625 * sum
            };
        }
    });
    picture
}

/// The room seen in passing: the mean of one picture for each pose, each sampled at one point of
/// every pixel, the points spread over the pixel. Depth is that of the middle pose, whose point is
/// the pixel's centre.
pub(crate) fn render_moving(room: &Room, camera: &Camera, poses: &[Se3]) -> Picture {
    let middle = poses.len() / 2;
    let mut picture = Picture::black(camera);
    for (moment, &world_from_camera) in poses.iter().enumerate() {
        let view = View {
            camera: *camera,
            world_from_camera,
        };
        let tracer = Tracer::new(room, &view);
        // A lattice that covers the pixel evenly: rows by turns, columns in steps of 2.
        let part = |k: usize| (k % poses.len()) as f64 / poses.len() as f64;
        let [du, dv] = [
            2 * (moment + poses.len() - middle),
            moment + poses.len() - middle,
        ]
        .map(|k| (part(k) + 0.5).fract() - 0.5);
        picture.for_each_row(|v, radiance, depth_m| {
            let samples = tracer.row(camera.width, [du, v as f64 + dv]);
            for (u, sample) in samples.iter().enumerate() {
                radiance[u] += sample.radiance / poses.len() as f32;
                if moment == middle {
                    depth_m[u] = sample.depth as f32;
                }
            }
        });
    }
    picture
}

fn is_close(a: &Sample, b: &Sample) -> bool {
    let difference = (a.radiance - b.radiance).abs();
    let allowed = (a.radiance.sup(&b.radiance) * CONTRAST).add_scalar(CONTRAST * DARK);
    (allowed - difference).min() >= 0.0
}
