//! A furnished room: solids with their patterns, and the irradiance baked onto them.
//!
//! Surfaces are Lambertian, so a point has the same radiance from every viewpoint.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use crate::builder::{Builder, Place};
use crate::bvh::Bvh;
use crate::layout::{self, Plan, WALL_M};
use crate::light::{Lamp, LightMap};
use crate::pattern::{Pattern, Rgb, Spot};
use crate::shape::{Ray, Solid};

/// A solid's material.
pub(crate) struct Finish {
    pub pattern: Pattern,
    pub seed: u32,
    /// Emitted radiance as a multiple of the albedo. Solids that emit light cast no shadow.
    pub glow: f32,
}

/// The first intersection of a ray with the scene.
#[derive(Clone, Copy)]
pub(crate) struct Hit {
    /// Ray parameter: distance in units of the ray's direction.
    pub t: f64,
    /// Index of the solid.
    pub solid: usize,
    /// Face of the solid.
    pub face: usize,
}

/// A closed furnished room, or a row of them. The world frame has z up, metres, and its origin at
/// the middle of the (first) floor.
pub struct Room {
    size: Vector3<f64>,
    thresholds: Vec<f64>,
    /// Parallel to `finishes`: the same index is the same solid.
    pub(crate) solids: Vec<Solid>,
    pub(crate) finishes: Vec<Finish>,
    pub(crate) lamps: Vec<Lamp>,
    bvh: Bvh,
    light: LightMap,
}

/// How the rooms of a ring lie: square, in two rows, the second one walked back.
#[derive(Clone, Copy)]
pub(crate) struct Ring {
    /// Rooms in a row.
    pub columns: usize,
    /// From the middle of a room to that of the next, metres.
    pub pitch_m: f64,
}

impl Ring {
    /// How many rooms; the ring is closed after that many.
    pub fn rooms(&self) -> usize {
        2 * self.columns
    }

    /// Whether the way turns left in a room: out of the wall at +y, not at +x, of the frame in which it came
    /// in at -x.
    pub fn turns(&self, room: usize) -> bool {
        let column = room % self.columns;
        column == 0 || column + 1 == self.columns
    }

    /// The frame of a room in which the way comes in at -x: its middle, metres, and its yaw, rad.
    pub fn frame(&self, room: usize) -> ([f64; 2], f64) {
        let (row, step) = (room / self.columns, room % self.columns);
        let column = if row == 0 {
            step
        } else {
            self.columns - 1 - step
        };
        let back = PI * row as f64;
        let yaw = if step == 0 { back - FRAC_PI_2 } else { back };
        ([column as f64, row as f64].map(|at| at * self.pitch_m), yaw)
    }
}

impl Room {
    /// The room generated from a seed. Rooms of different seeds differ in size, furniture,
    /// materials and light, those of consecutive seeds also in kind (living room, study, dining
    /// room). Takes about a second, which is spent on baking the light.
    pub fn new(seed: u64) -> Self {
        Self::row(seed, 1)
    }

    /// A row of `count` rooms along x, generated from consecutive seeds starting at `seed`. Open
    /// doorways, 1 m wide and 2.1 m high, join them in the middle of the walls between them.
    pub fn row(seed: u64, count: usize) -> Self {
        Self::unlit_row(seed, count).lit(seed)
    }

    /// The room of [`new`](Self::new), but a hand wider, without half of its small things, and with other
    /// pictures, titles and grain.
    pub(crate) fn look_alike(seed: u64) -> Self {
        const WIDER_M: f64 = 0.15;
        const SMALL_M: f64 = 0.35;
        let mut room = Self::unlit_row_wider(seed, 1, WIDER_M);
        let stays = |index: usize, solid: &Solid| {
            let [low, high] = solid.bounds();
            (high - low).max() > SMALL_M || index.is_multiple_of(2)
        };
        (room.solids, room.finishes) = (room.solids.into_iter().zip(room.finishes).enumerate())
            .filter(|(index, (solid, _))| stays(*index, solid))
            .map(|(_, both)| both)
            .unzip();
        for finish in &mut room.finishes {
            finish.seed = finish.seed.wrapping_add(1000);
        }
        room.bvh = Bvh::new(&room.solids);
        room.lit(seed)
    }

    /// With the light of its lamps.
    pub(crate) fn lit(mut self, seed: u64) -> Self {
        self.light = LightMap::bake(&self, seed);
        self
    }

    /// A ring of two rows of `columns` rooms, at least two, generated from consecutive seeds starting at
    /// `seed`, of one size. Open doorways join each with the next.
    pub(crate) fn ring(seed: u64, columns: usize) -> (Self, Ring) {
        let (room, ring) = Self::unlit_ring(seed, columns);
        (room.lit(seed), ring)
    }

    pub(crate) fn unlit_ring(seed: u64, columns: usize) -> (Self, Ring) {
        let size = Vector3::new(5.2, 5.2, 2.6);
        let ring = Ring {
            columns,
            pitch_m: size.x + 2.0 * WALL_M,
        };
        let mut builder = Builder::new(Pcg64Mcg::seed_from_u64(seed));
        for i in 0..ring.rooms() {
            let seed = seed.wrapping_add(i as u64);
            builder.rng = Pcg64Mcg::seed_from_u64(seed);
            let ([x, y], yaw) = ring.frame(i);
            let turns = ring.turns(i);
            let plan = Plan {
                middle: Place::new([x, y, 0.0], yaw),
                size,
                kind: seed % 3,
                doorways: [false, !turns, turns, true],
            };
            layout::furnish(&mut builder, &plan);
        }
        (Self::unlit(builder, size), ring)
    }

    pub(crate) fn unlit_row(seed: u64, count: usize) -> Self {
        Self::unlit_row_wider(seed, count, 0.0)
    }

    /// Each room is so much wider and deeper than its seed says, metres.
    fn unlit_row_wider(seed: u64, count: usize, wider_m: f64) -> Self {
        let mut builder = Builder::new(Pcg64Mcg::seed_from_u64(seed));
        let mut thresholds: Vec<f64> = Vec::new();
        let mut size: Vector3<f64> = Vector3::zeros();
        for i in 0..count {
            let seed = seed.wrapping_add(i as u64);
            builder.rng = Pcg64Mcg::seed_from_u64(seed);
            let own_size = layout::size(&mut builder) + Vector3::new(wider_m, wider_m, 0.0);
            let half = 0.5 * own_size.x;
            let middle_x = match thresholds.last() {
                None => 0.0,
                Some(threshold) => threshold + WALL_M + half,
            };
            if thresholds.is_empty() {
                thresholds.push(-half);
            }
            let has_next = i + 1 < count;
            let end = middle_x + half + if has_next { WALL_M } else { 0.0 };
            thresholds.push(end);
            let plan = Plan {
                middle: Place::new([middle_x, 0.0, 0.0], 0.0),
                size: own_size,
                kind: seed % 3,
                doorways: [false, has_next, false, i > 0],
            };
            layout::furnish(&mut builder, &plan);
            size = Vector3::new(
                end - thresholds[0],
                size.y.max(own_size.y),
                size.z.max(own_size.z),
            );
        }
        Self {
            thresholds,
            ..Self::unlit(builder, size)
        }
    }

    /// The builder's room without any light.
    pub(crate) fn unlit(builder: Builder, size: Vector3<f64>) -> Self {
        let Builder {
            solids,
            finishes,
            lamps,
            ..
        } = builder;
        Self {
            bvh: Bvh::new(&solids),
            light: LightMap::dark(&solids),
            size,
            thresholds: Vec::new(),
            solids,
            finishes,
            lamps,
        }
    }

    /// Where each room begins along x, and where the last one ends: x of the outer wall of the
    /// first room, of the middle of each doorway, and of the outer wall of the last room.
    pub(crate) fn thresholds(&self) -> &[f64] {
        &self.thresholds
    }

    /// Inner width (x), depth (y) and height (z), metres. For a row of rooms the width spans from
    /// the first wall to the last, and depth and height are the largest of any room.
    pub fn size(&self) -> Vector3<f64> {
        self.size
    }

    /// The first intersection with `t` > 0. `likely` is a guess at the solid: testing it first
    /// lets the traversal skip what lies behind it.
    pub(crate) fn meet(&self, ray: &Ray, likely: Option<usize>) -> Option<Hit> {
        let mut best = None;
        let mut meet = |solid: usize, limit: &mut f64| {
            if let Some((t, face)) = self.solids[solid].meet(ray, 0.0, *limit) {
                *limit = t;
                best = Some(Hit { t, solid, face });
            }
        };
        let mut limit = f64::INFINITY;
        if let Some(solid) = likely {
            meet(solid, &mut limit);
        }
        self.bvh.visit(ray, &mut limit, meet);
        best
    }

    /// Shadow ray: whether a solid that casts a shadow blocks the ray before t = 1.
    pub(crate) fn is_blocked(&self, ray: &Ray) -> bool {
        let mut limit = 1.0;
        self.bvh.visit(ray, &mut limit, |solid, limit| {
            let casts_shadow = self.finishes[solid].glow == 0.0;
            if casts_shadow && self.solids[solid].meet(ray, 0.0, *limit).is_some() {
                // Any hit will do: ends the traversal.
                *limit = 0.0;
            }
        });
        limit == 0.0
    }

    /// Linear radiance leaving a hit point towards the ray's origin. `pixel_angle` is the angle
    /// that a pixel subtends there, rad.
    pub(crate) fn radiance(&self, ray: &Ray, hit: &Hit, pixel_angle: f64) -> Rgb {
        let at = self.solids[hit.solid].locate(hit.face, &ray.at(hit.t));
        let length = ray.direction.norm();
        // At a slant the pixel's footprint is stretched by 1 / cosine in one direction. Use the
        // geometric mean of both directions, with the stretch limited to tenfold.
        let cosine = (at.normal.dot(&ray.direction).abs() / length).max(0.01);
        let footprint = (hit.t * length * pixel_angle / cosine.sqrt()) as f32;
        let finish = &self.finishes[hit.solid];
        let albedo = finish.albedo(hit.face, at.uv, at.size, footprint);
        let light = self.light.at(hit.solid, hit.face, at.uv);
        albedo.component_mul(&light.add_scalar(finish.glow))
    }
}

impl Finish {
    pub fn albedo(&self, face: usize, uv: [f64; 2], size: [f64; 2], footprint: f32) -> Rgb {
        self.pattern.albedo(&Spot {
            u: uv[0] as f32,
            v: uv[1] as f32,
            size: size.map(|s| s as f32),
            footprint,
            seed: self.seed.wrapping_add(face as u32),
        })
    }
}
