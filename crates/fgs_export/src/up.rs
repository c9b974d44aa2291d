//! Which way is up: the direction to which floors and tables are normal and walls are parallel.
//!
//! The world of a run is its first camera, so its floor is as oblique as the camera was held. Rooms are built
//! of level and of upright surfaces, and people hold cameras more or less upright; so the direction is looked
//! for near that of the cameras. A phone that was held on its side all the time is taken for an upright one.
//! Normals come from planes through centres: a gaussian's own shortest axis is off by 36 degrees in the
//! median once it was optimised.

use std::collections::BTreeMap;

use fgs_splat::Gaussians;
use nalgebra::{Matrix3, SymmetricEigen, Vector3};

use crate::quantities::is_surface;

/// Side of the cells in which planes are fitted, metres: pieces of floors, tables and walls.
const CELL_M: f64 = 0.2;
/// Fewer centres may lie in a plane by chance.
const MIN_CENTRES: f64 = 12.0;
/// Variance across a plane, of that along it.
const MAX_FLATNESS: f64 = 0.02;
/// The cameras' upward directions are at most so far off, radians: 60 degrees.
const MAX_TILT_RAD: f64 = std::f64::consts::FRAC_PI_3;
/// Within so many radians a surface counts as level or upright; the first is for a coarse guess.
const TOLERANCES_RAD: [f64; 4] = [0.35, 0.2, 0.1, 0.05];
/// At least this share of the surfaces must be level or upright at the end. Of directions without any
/// order a tenth would be.
const MIN_SHARE: f64 = 0.3;

/// The upward direction in the map's coordinates, of length 1. `camera_up` is about upward: the mean of
/// the cameras' -y axes, or -y of the world, which is the first camera, if nothing else is known. It is the
/// answer if the map does not show another.
pub fn up_direction(gaussians: &Gaussians, camera_up: Vector3<f64>) -> Vector3<f64> {
    let camera_up = camera_up
        .try_normalize(1e-9)
        .unwrap_or_else(|| -Vector3::y());
    let normals = normals(gaussians);
    let candidates = directions_around(camera_up)
        .map(|start| refined(&normals, start))
        .filter(|up| up.dot(&camera_up) >= MAX_TILT_RAD.cos())
        // Of directions that fit alike, as in a corner without a floor, the one nearest the cameras'.
        .map(|up| (share(&normals, &up) + 0.1 * up.dot(&camera_up), up));
    let best = candidates.max_by(|a, b| a.0.total_cmp(&b.0));
    best.filter(|(_, up)| share(&normals, up) >= MIN_SHARE)
        .map_or(camera_up, |(_, up)| up)
}

/// The normal of a piece of surface, of length 1 and of either sign, and how much it counts.
struct Normal {
    direction: Vector3<f64>,
    weight: f64,
}

/// Sums over the centres in a cell, from its corner.
#[derive(Clone, Default)]
struct Cell {
    count: f64,
    sum: Vector3<f64>,
    outer: Matrix3<f64>,
}

impl Cell {
    /// The plane of the centres, if they have one; it counts by its area.
    fn normal(&self) -> Option<Normal> {
        if self.count < MIN_CENTRES {
            return None;
        }
        let mean = self.sum / self.count;
        let covariance = self.outer / self.count - mean * mean.transpose();
        let eigen = SymmetricEigen::new(covariance);
        let flat = eigen.eigenvalues.imin();
        let [a, b] = [(flat + 1) % 3, (flat + 2) % 3].map(|i| eigen.eigenvalues[i]);
        let is_flat = eigen.eigenvalues[flat] < MAX_FLATNESS * a.min(b);
        is_flat.then(|| Normal {
            direction: eigen.eigenvectors.column(flat).into(),
            weight: (a * b).sqrt(),
        })
    }
}

/// The normals of flat pieces of surface.
fn normals(gaussians: &Gaussians) -> Vec<Normal> {
    let mut cells: BTreeMap<[i64; 3], Cell> = BTreeMap::new();
    for i in (0..gaussians.len()).filter(|i| is_surface(gaussians, *i)) {
        let centre = Vector3::from(gaussians.means[i]).cast::<f64>();
        if centre.iter().all(|x| x.is_finite()) {
            // Far outside numbers are cut off, and share a cell that is not flat.
            let index = (centre / CELL_M).map(|x| x.floor() as i64);
            let centre = centre - index.map(|x| x as f64) * CELL_M;
            let cell = cells.entry(index.into()).or_default();
            cell.count += 1.0;
            cell.sum += centre;
            cell.outer += centre * centre.transpose();
        }
    }
    cells.values().filter_map(Cell::normal).collect()
}

/// Directions spread over all that cameras may be off.
fn directions_around(camera_up: Vector3<f64>) -> impl Iterator<Item = Vector3<f64>> {
    let aside = camera_up
        .cross(&Vector3::ith(camera_up.iamin(), 1.0))
        .normalize();
    let forward = camera_up.cross(&aside);
    let rings = [(0.0, 1), (0.3, 6), (0.6, 12), (0.9, 18)];
    rings.into_iter().flat_map(move |(tilt_rad, count)| {
        (0..count).map(move |i| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / f64::from(count)).sin_cos();
            let aside = (aside * cos + forward * sin) * f64::sin(tilt_rad);
            camera_up * f64::cos(tilt_rad) + aside
        })
    })
}

/// The direction near `up` that level surfaces' normals agree with most, and upright ones' least:
/// the largest eigenvector of their difference, of ever closer surfaces.
fn refined(normals: &[Normal], up: Vector3<f64>) -> Vector3<f64> {
    TOLERANCES_RAD.into_iter().fold(up, |up, tolerance_rad| {
        let mut moments = Matrix3::zeros();
        for Normal { direction, weight } in normals {
            let along = direction.dot(&up).abs();
            let outer = direction * direction.transpose() * *weight;
            if along > tolerance_rad.cos() {
                moments += outer;
            } else if along < tolerance_rad.sin() {
                moments -= outer;
            }
        }
        let eigen = SymmetricEigen::new(moments);
        let refined = eigen.eigenvectors.column(eigen.eigenvalues.imax());
        let refined = refined * refined.dot(&up).signum();
        // Nothing level or upright is in sight of this start.
        if moments == Matrix3::zeros() {
            up
        } else {
            refined
        }
    })
}

/// Share of the surfaces that are level or upright where `up` is upward.
fn share(normals: &[Normal], up: &Vector3<f64>) -> f64 {
    let tolerance_rad = TOLERANCES_RAD[2];
    let fits = |normal: &&Normal| {
        let along = normal.direction.dot(up).abs();
        along > tolerance_rad.cos() || along < tolerance_rad.sin()
    };
    let total: f64 = normals.iter().map(|normal| normal.weight).sum();
    let fitting: f64 = normals
        .iter()
        .filter(fits)
        .map(|normal| normal.weight)
        .sum();
    if total > 0.0 { fitting / total } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use fgs_splat::Gaussian;
    use fgs_synth::{FRAMES_PER_LOOP, SensorModel, Sequence, kinect_camera};
    use nalgebra::UnitQuaternion;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    fn add(map: &mut Gaussians, mean: Vector3<f64>) {
        map.push(&Gaussian {
            mean: mean.map(|x| x as f32).into(),
            quat: [1.0, 0.0, 0.0, 0.0],
            scales: [0.02, 0.02, 0.002],
            opacity: 0.9,
            rgb: [0.5; 3],
        });
    }

    /// The surfaces that the cameras of every eighth frame of a synthetic room measure, and their mean upward
    /// direction, in the room's coordinates, where z is up.
    fn room(frames: usize) -> (Vec<Vector3<f64>>, Vector3<f64>) {
        let camera = kinect_camera(160, 120).unwrap();
        let sequence = Sequence::new(3, FRAMES_PER_LOOP, camera, SensorModel::kinect());
        let (mut points, mut cameras_up) = (Vec::new(), Vector3::zeros());
        for i in (0..frames).step_by(8) {
            let (frame, pose) = (sequence.frame(i), sequence.world_from_camera(i));
            cameras_up -= pose.rotation * Vector3::y();
            for (v, u) in (0..120)
                .step_by(2)
                .flat_map(|v| (0..160).step_by(2).map(move |u| (v, u)))
            {
                let depth_m = f64::from(frame.depth_m.at(u, v));
                if depth_m > 0.0 {
                    points.push(pose.transform(&camera.unproject(u as f64, v as f64, depth_m)));
                }
            }
        }
        (points, cameras_up)
    }

    #[test]
    fn the_synthetic_room_is_level_however_its_first_camera_was_held() {
        let mut rng = Pcg64::seed_from_u64(5);
        // The whole room, and the little that the first frames see of it.
        for frames in [FRAMES_PER_LOOP, 10] {
            let (points, cameras_up) = room(frames);
            for _ in 0..6 {
                let axis = Vector3::from_fn(|_, _| rng.random_range(-2.0..2.0));
                let rotation = UnitQuaternion::from_scaled_axis(axis);
                let mut map = Gaussians::default();
                points
                    .iter()
                    .for_each(|point| add(&mut map, rotation * point));
                let up = up_direction(&map, rotation * cameras_up);
                let error_deg = up.angle(&(rotation * Vector3::z())).to_degrees();
                assert!(error_deg < 1.0, "{frames} frames: {error_deg} degrees");
            }
        }
    }

    #[test]
    fn without_order_the_cameras_decide() {
        let up = Vector3::new(0.1, -1.0, 0.2).normalize();
        let nothing = Gaussians::default();
        assert!((up_direction(&nothing, up) - up).norm() < 1e-9);
        assert_eq!(up_direction(&nothing, Vector3::zeros()), -Vector3::y());
        let mut rng = Pcg64::seed_from_u64(1);
        let mut map = Gaussians::default();
        for _ in 0..400 {
            // A flat piece of any direction in a cell of its own.
            let turn = UnitQuaternion::from_scaled_axis(Vector3::from_fn(|_, _| {
                rng.random_range(-3.0..3.0)
            }));
            let cell = Vector3::from_fn(|_, _| f64::from(rng.random_range(-9..9))).add_scalar(0.5)
                * CELL_M;
            for _ in 0..20 {
                let [x, y] = [rng.random_range(-0.05..0.05), rng.random_range(-0.05..0.05)];
                add(&mut map, cell + turn * Vector3::new(x, y, 0.0));
            }
        }
        assert!((up_direction(&map, up) - up).norm() < 1e-9);
        map.means[0] = [f32::NAN; 3];
        map.means[1] = [f32::MAX; 3];
        assert!((up_direction(&map, up) - up).norm() < 1e-9);
    }
}
