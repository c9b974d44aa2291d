//! Ray casting: exact depth at pixel centres and anti-aliased linear colour.
//!
//! Adaptive supersampling: each pixel averages its centre and its four corners (shared with its
//! neighbours) and, where these differ, the midpoints of its sides as well. No pixel depends on
//! the order of evaluation, so any number of threads renders the same image.

use fgs_geom::{Camera, Image, Se3, View};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use crate::pattern::Rgb;
use crate::room::{Hit, Room};
use crate::shape::Ray;

/// Relative difference between samples, per channel, above which a pixel gets more samples. A
/// smaller one would not show in the average of five.
const CONTRAST: f32 = 0.1;
/// Radiance added to the reference of that contrast, so that differences near black do not count:
/// about two 8-bit steps there.
const DARK: f32 = 0.02;

/// A rendered image: linear radiance and depth.
pub(crate) struct Picture {
    pub radiance: Image<Rgb>,
    /// Depth along the camera's z, metres; 0 where the ray hit nothing.
    pub depth_m: Image<f32>,
}

impl Picture {
    pub fn black(camera: &Camera) -> Self {
        Self {
            radiance: Image::filled(camera.width, camera.height, Rgb::zeros()),
            depth_m: Image::filled(camera.width, camera.height, 0.0),
        }
    }

    /// Something nearer comes before what is there.
    pub fn cover(&mut self, other: &Self) {
        let (width, height) = (self.depth_m.width(), self.depth_m.height());
        for (u, v) in (0..height).flat_map(|v| (0..width).map(move |u| (u, v))) {
            let (there, nearer) = (self.depth_m.at(u, v), other.depth_m.at(u, v));
            if nearer > 0.0 && !(there > 0.0 && there <= nearer) {
                self.depth_m.set(u, v, nearer);
                self.radiance.set(u, v, other.radiance.at(u, v));
            }
        }
    }

    /// Calls `fill` in parallel with each row's index, radiance and depth.
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
    /// Solid and face hit, `None` if the ray left the scene.
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

    /// The ray through an image point, in the world frame. Its direction has z = 1 in the camera
    /// frame, so that the ray parameter is the depth.
    fn ray(&self, u: f64, v: f64) -> Ray {
        Ray {
            origin: self.origin,
            direction: self.world_from_camera * self.camera.ray(u, v),
        }
    }

    fn shade(&self, ray: &Ray, hit: &Hit) -> Rgb {
        (self.room).radiance(ray, hit, 1.0 / self.camera.intrinsics.fx)
    }

    /// Casts a ray through an image point. `likely` is the solid hit by a neighbouring sample.
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

    /// Radiance at an image point where `solid` is known to be frontmost, which saves traversing
    /// the scene.
    fn sample_solid(&self, u: f64, v: f64, solid: usize) -> Option<Rgb> {
        let ray = self.ray(u, v);
        let (t, face) = self.room.solids[solid].meet(&ray, 0.0, f64::INFINITY)?;
        Some(self.shade(&ray, &Hit { t, solid, face }))
    }

    /// A row of samples one pixel apart, starting at (`left`, `v`).
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

    /// The sum of radiance at the midpoints of a pixel's sides. If a single face covers the pixel,
    /// only its pattern varies, so its solid alone is intersected.
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

/// Renders the room from a view.
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
            // Tent filter over the pixel.
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

/// Renders the room with motion blur: the mean of one image per pose, each with one sample per
/// pixel, and with the samples spread over the pixel for anti-aliasing. Depth is that of the middle
/// pose, which samples the pixel's centre.
pub(crate) fn render_moving(room: &Room, camera: &Camera, poses: &[Se3]) -> Picture {
    let middle = poses.len() / 2;
    let mut picture = Picture::black(camera);
    for (moment, &world_from_camera) in poses.iter().enumerate() {
        let view = View {
            camera: *camera,
            world_from_camera,
        };
        let tracer = Tracer::new(room, &view);
        // Rank-1 lattice, which covers the pixel evenly: from pose to pose v advances by one step
        // and u by two.
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
