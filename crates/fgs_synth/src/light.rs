//! Baked irradiance: soft shadows from area lamps, one diffuse bounce and an estimate of all
//! further bounces, computed once per room.
//!
//! Each face carries a light map, a grid of irradiance, all scaled by one exposure to a fixed
//! median. Units are such that a white surface (albedo 1) under irradiance 1 has radiance 1. Each
//! cell has its own random generator, so the result does not depend on the number of threads.

use std::f64::consts::PI;

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use crate::pattern::Rgb;
use crate::room::Room;
use crate::shape::{Ray, Solid};

/// Cell size of the light maps, metres: about as wide as the penumbra of furniture.
const CELL_M: f64 = 0.08;
/// Shadow rays per cell and lamp.
const LAMP_RAYS: usize = 10;
/// Bounce rays are stratified on a square grid of this many strata a side.
const BOUNCE_SIDE: usize = 6;
/// Ray origins are offset along the normal by this much, metres, against self-intersection: well
/// above rounding error, well below any gap between solids.
const OFFSET_M: f64 = 1e-4;
/// Lower bound on the distance to a lamp, metres. Without it a lamp would overexpose its own shade.
const NEAREST_LAMP_M: f64 = 0.35;
/// Lamps farther away than this, metres, are ignored. No room is that long, and what comes through
/// doorways from there is less than a hundredth of the light of the room's own lamps.
const FARTHEST_LAMP_M: f64 = 9.0;
/// Light of the second and all further bounces relative to the first: with a mean albedo of 0.4
/// the rest of the geometric series sums to 0.4 / 0.6.
const FURTHER_BOUNCES: f32 = 0.67;

/// Median irradiance after exposure: leaves headroom for surfaces close to a lamp or window.
const MEDIAN: f32 = 0.42;

/// An area light: a box that emits equally in all directions.
pub(crate) struct Lamp {
    pub center: Vector3<f64>,
    pub half: Vector3<f64>,
    pub power: Rgb,
}

struct Grid {
    cells: [usize; 2],
    size: [f64; 2],
    irradiance: Vec<Rgb>,
}

/// The light maps of a room, indexed by solid, then face.
pub(crate) struct LightMap {
    faces: Vec<Vec<Grid>>,
}

impl LightMap {
    /// Light maps of zero irradiance.
    pub fn dark(solids: &[Solid]) -> Self {
        let faces = solids.iter().map(|solid| {
            let sizes = (0..solid.face_count()).map(|face| solid.face_size(face));
            sizes.map(Grid::dark).collect()
        });
        Self {
            faces: faces.collect(),
        }
    }

    /// Bakes the light of the room's lamps.
    pub fn bake(room: &Room, seed: u64) -> Self {
        let mut map = Self::dark(&room.solids);
        let places = map.places(&room.solids);
        let for_each_cell = |light: &(dyn Fn(&Place, &mut Pcg64Mcg) -> Option<Rgb> + Sync)| {
            (places.par_iter().enumerate())
                .map(|(cell, place)| {
                    // Gives each cell its own seed.
                    let mut rng = Pcg64Mcg::seed_from_u64(seed ^ (2 * cell as u64 + 1) << 20);
                    light(place, &mut rng)
                })
                .collect::<Vec<_>>()
        };
        let direct = for_each_cell(&|place, rng| Some(lamp_light(room, place, rng)));
        map.set(&direct);
        let albedos: Vec<Rgb> = (0..room.solids.len())
            .map(|solid| mean_albedo(room, solid))
            .collect();
        let bounced = for_each_cell(&|place, rng| map.bounce_light(room, &albedos, place, rng));
        let sum = |(bounced, direct): (&Option<Rgb>, &Option<Rgb>)| {
            Some(direct.as_ref()? + bounced.as_ref()? * (1.0 + FURTHER_BOUNCES))
        };
        let total: Vec<Option<Rgb>> = bounced.iter().zip(&direct).map(sum).collect();
        map.set(&total);
        let mut from = 0;
        for grid in map.faces.iter_mut().flatten() {
            let count = grid.irradiance.len();
            grid.smooth(&total[from..from + count]);
            from += count;
        }
        map.expose();
        map
    }

    /// Irradiance at a point of a face, interpolated bilinearly.
    pub fn at(&self, solid: usize, face: usize, uv: [f64; 2]) -> Rgb {
        self.faces[solid][face].at(uv)
    }

    fn places(&self, solids: &[Solid]) -> Vec<Place> {
        let mut places = Vec::new();
        for (solid, grids) in solids.iter().zip(&self.faces) {
            for (face, grid) in grids.iter().enumerate() {
                let [columns, rows] = grid.cells;
                for i in 0..columns * rows {
                    let middle = |k: usize, axis: usize| {
                        (k as f64 + 0.5) * grid.size[axis] / grid.cells[axis] as f64
                    };
                    let uv = [middle(i % columns, 0), middle(i / columns, 1)];
                    let (point, normal) = solid.place(face, uv);
                    places.push(Place {
                        point: point + OFFSET_M * normal,
                        normal,
                    });
                }
            }
        }
        places
    }

    fn set(&mut self, values: &[Option<Rgb>]) {
        let cells = (self.faces.iter_mut().flatten()).flat_map(|grid| &mut grid.irradiance);
        for (cell, value) in cells.zip(values) {
            *cell = value.unwrap_or_default();
        }
    }

    /// Irradiance from light reflected once by other surfaces, or `None` if the cell is inside a
    /// solid.
    fn bounce_light(
        &self,
        room: &Room,
        albedos: &[Rgb],
        place: &Place,
        rng: &mut Pcg64Mcg,
    ) -> Option<Rgb> {
        let tangent = place.normal.cross(&least_axis(&place.normal)).normalize();
        let bitangent = place.normal.cross(&tangent);
        let mut sum = Rgb::zeros();
        let mut buried = 0;
        for i in 0..BOUNCE_SIDE * BOUNCE_SIDE {
            // Cosine-weighted hemisphere sampling: points of a disc, lifted to the hemisphere.
            let stratum = |k: usize, random: f64| (k as f64 + random) / BOUNCE_SIDE as f64;
            let radius2 = stratum(i % BOUNCE_SIDE, rng.random());
            let (sin, cos) = (2.0 * PI * stratum(i / BOUNCE_SIDE, rng.random())).sin_cos();
            let radius = radius2.sqrt();
            let direction =
                radius * (cos * tangent + sin * bitangent) + (1.0 - radius2).sqrt() * place.normal;
            let ray = Ray {
                origin: place.point,
                direction,
            };
            let Some(hit) = room.meet(&ray, None) else {
                continue;
            };
            let at = room.solids[hit.solid].locate(hit.face, &ray.at(hit.t));
            if at.normal.dot(&direction) > 0.0 {
                buried += 1;
            } else {
                sum += albedos[hit.solid].component_mul(&self.at(hit.solid, hit.face, at.uv));
            }
        }
        let count = BOUNCE_SIDE * BOUNCE_SIDE;
        (2 * buried < count).then(|| sum / (count - buried) as f32)
    }

    /// Sets the exposure: scales the irradiance so that its median over all lit cells is
    /// [`MEDIAN`].
    fn expose(&mut self) {
        let mut levels: Vec<f32> = (self.faces.iter().flatten())
            .flat_map(|grid| grid.irradiance.iter().map(|e| e.sum() / 3.0))
            .filter(|level| *level > 0.0)
            .collect();
        levels.sort_by(f32::total_cmp);
        let Some(median) = levels.get(levels.len() / 2) else {
            return;
        };
        let gain = MEDIAN / median;
        for grid in self.faces.iter_mut().flatten() {
            for value in &mut grid.irradiance {
                *value *= gain;
            }
        }
    }
}

/// A point offset just off a surface, and the surface normal.
struct Place {
    point: Vector3<f64>,
    normal: Vector3<f64>,
}

fn lamp_light(room: &Room, place: &Place, rng: &mut Pcg64Mcg) -> Rgb {
    let mut sum = Rgb::zeros();
    for lamp in &room.lamps {
        if (lamp.center - place.point).norm() > FARTHEST_LAMP_M {
            continue;
        }
        let mut arriving = 0.0;
        for _ in 0..LAMP_RAYS {
            let jitter = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0));
            let direction = lamp.center + lamp.half.component_mul(&jitter) - place.point;
            let distance2 = direction
                .norm_squared()
                .max(NEAREST_LAMP_M * NEAREST_LAMP_M);
            let cosine = place.normal.dot(&direction) / distance2.sqrt();
            let ray = Ray {
                origin: place.point,
                direction,
            };
            if cosine > 0.0 && !room.is_blocked(&ray) {
                arriving += cosine / distance2;
            }
        }
        sum += lamp.power * (arriving / LAMP_RAYS as f64) as f32;
    }
    sum
}

fn mean_albedo(room: &Room, solid: usize) -> Rgb {
    let faces = room.solids[solid].face_count();
    let mut sum = Rgb::zeros();
    // 48 samples, spread equally over the faces, are enough for a mean colour.
    let count = 48 / faces;
    for face in 0..faces {
        let size = room.solids[solid].face_size(face);
        for i in 0..count {
            // Golden ratio steps in v make a lattice that covers the face evenly.
            let uv = [
                size[0] * (i as f64 + 0.5) / count as f64,
                size[1] * (0.618_034 * i as f64).fract(),
            ];
            sum += room.finishes[solid].albedo(face, uv, size, 0.02);
        }
    }
    sum / (faces * count) as f32
}

fn least_axis(direction: &Vector3<f64>) -> Vector3<f64> {
    Vector3::ith(direction.abs().imin(), 1.0)
}

impl Grid {
    fn dark(size: [f64; 2]) -> Self {
        let cells = size.map(|side| ((side / CELL_M).ceil() as usize).max(2));
        Self {
            cells,
            size,
            irradiance: vec![Rgb::zeros(); cells[0] * cells[1]],
        }
    }

    fn at(&self, uv: [f64; 2]) -> Rgb {
        let position = |axis: usize| {
            let last = (self.cells[axis] - 1) as f64;
            let x = (uv[axis] / self.size[axis] * self.cells[axis] as f64 - 0.5).clamp(0.0, last);
            let low = (x as usize).min(self.cells[axis] - 2);
            (low, (x - low as f64) as f32)
        };
        let ((i, a), (j, b)) = (position(0), position(1));
        let columns = self.cells[0];
        let at = |i: usize, j: usize| &self.irradiance[j * columns + i];
        let near = at(i, j) * (1.0 - a) + at(i + 1, j) * a;
        let far = at(i, j + 1) * (1.0 - a) + at(i + 1, j + 1) * a;
        near * (1.0 - b) + far * b
    }

    /// Box filter over the known values of each 3x3 neighbourhood. It averages out Monte Carlo
    /// noise and extends the map two cells into other solids, where bilinear lookups at their
    /// edges reach; cells further inside are never seen.
    fn smooth(&mut self, values: &[Option<Rgb>]) {
        let once = self.mean_of_neighbours(values);
        let gaps_filled: Vec<Option<Rgb>> = (values.iter().zip(&once))
            .map(|(value, mean)| value.or(*mean))
            .collect();
        let twice = self.mean_of_neighbours(&gaps_filled);
        for (cell, mean) in self.irradiance.iter_mut().zip(&twice) {
            *cell = mean.unwrap_or_default();
        }
    }

    fn mean_of_neighbours(&self, values: &[Option<Rgb>]) -> Vec<Option<Rgb>> {
        let [columns, rows] = self.cells;
        let mean = |cell: usize| {
            let (i, j) = (cell % columns, cell / columns);
            let mut sum = Rgb::zeros();
            let mut count = 0;
            for j in j.saturating_sub(1)..(j + 2).min(rows) {
                for i in i.saturating_sub(1)..(i + 2).min(columns) {
                    if let Some(value) = values[j * columns + i] {
                        sum += value;
                        count += 1;
                    }
                }
            }
            (count > 0).then(|| sum / count as f32)
        };
        (0..columns * rows).map(mean).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::builder::{self, Builder};
    use crate::pattern::Pattern;

    /// A bare floor, a small lamp 1 m above its middle, and a shelf that shadows one side.
    #[test]
    fn light_falls_off_and_casts_shadows() {
        let mut b = Builder::new(Pcg64Mcg::seed_from_u64(1));
        let at = builder::Place::new([0.0; 3], 0.0);
        let grey = Pattern::Paint(Rgb::repeat(0.5));
        b.block(at, [-2.0, -2.0, -0.1], [2.0, 2.0, 0.0], grey);
        b.block(
            at,
            [0.6, -2.0, 0.5],
            [2.0, 2.0, 0.52],
            Pattern::Paint(Rgb::zeros()),
        );
        b.lamp(at, [0.0, 0.0, 1.0], [0.01; 3], Rgb::repeat(3.0));
        let room = Room::unlit(b, Vector3::zeros());
        let map = LightMap::bake(&room, 1);
        // The floor's top is face 5, its corner at (-2, -2).
        let at = |x: f64, y: f64| map.at(0, 5, [x + 2.0, y + 2.0]).x;
        let middle = at(0.0, 0.0);
        for (x, y) in [(-1.0, 0.0), (0.0, 0.8), (-1.0, -1.0)] {
            // cos / d^2, d^2 = 1 + x^2 + y^2
            let expected = (1.0_f64 + x * x + y * y).powf(-1.5) as f32;
            assert!((at(x, y) / middle - expected).abs() <= 0.03, "{x} {y}");
        }
        assert!(at(1.6, 0.0) <= 0.02 * middle);
    }
}
