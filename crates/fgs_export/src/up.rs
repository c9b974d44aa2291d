//! Which way is up: the direction to which floors and tables are normal and walls are parallel.
//!
//! The world of a run is its first camera, so its floor is as oblique as the camera was held. Gaussians on
//! surfaces are flat, and their shortest axis is the surface's normal. Rooms are built of level and of
//! upright surfaces, and people hold cameras more or less upright; so the direction is looked for near that of the
//! cameras. A phone that was held on its side all the time is taken for an upright one.

use fgs_splat::Gaussians;
use nalgebra::{Matrix3, Quaternion, SymmetricEigen, UnitQuaternion, Vector3};

use crate::quantities::{is_surface, unit_quat};

/// So many gaussians, evenly spread over the map, tell as much as all.
const MAX_NORMALS: usize = 20_000;
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

/// A surface's normal of length 1, of either sign, and how much it counts.
struct Normal {
    direction: Vector3<f64>,
    weight: f64,
}

/// The normals of gaussians on surfaces, weighted by area times opacity.
fn normals(gaussians: &Gaussians) -> Vec<Normal> {
    let stride = gaussians.len().div_ceil(MAX_NORMALS).max(1);
    let surfaces = (0..gaussians.len())
        .step_by(stride)
        .filter(|i| is_surface(gaussians, *i));
    surfaces
        .filter_map(|i| {
            let scales = gaussians.scales(i).map(f64::from);
            let [w, x, y, z] = unit_quat(gaussians, i).map(f64::from);
            let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
            let shortest = (0..3).min_by(|a, b| scales[*a].total_cmp(&scales[*b]))?;
            let area = scales.iter().product::<f64>() / scales[shortest];
            let weight = area * f64::from(gaussians.opacity(i));
            weight.is_finite().then(|| Normal {
                direction: rotation * Vector3::ith(shortest, 1.0),
                weight,
            })
        })
        .collect()
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
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    /// Flat gaussians whose third axis is `normal` turned by up to 5 degrees.
    fn add_surface(
        map: &mut Gaussians,
        rotation: &UnitQuaternion<f64>,
        normal: Vector3<f64>,
        count: usize,
        rng: &mut Pcg64,
    ) {
        for _ in 0..count {
            let noise = Vector3::from_fn(|_, _| rng.random_range(-0.05..0.05));
            let normal = rotation * (normal + noise).normalize();
            let turn = UnitQuaternion::rotation_between(&Vector3::z(), &normal);
            let turn =
                turn.unwrap_or_else(|| UnitQuaternion::new(Vector3::x() * std::f64::consts::PI));
            map.push(&Gaussian {
                mean: [0.0; 3],
                quat: [turn.w, turn.i, turn.j, turn.k].map(|q| q as f32),
                scales: [0.02, 0.02, 0.002],
                opacity: 0.9,
                rgb: [0.5; 3],
            });
        }
    }

    /// A room with more wall than floor, walls at any angle, and things without any order; y is down.
    fn room(rotation: &UnitQuaternion<f64>, seed: u64) -> Gaussians {
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut map = Gaussians::default();
        add_surface(&mut map, rotation, Vector3::y(), 300, &mut rng);
        for heading in [0.2_f64, 0.2 + std::f64::consts::FRAC_PI_2, 1.1] {
            let normal = Vector3::new(heading.cos(), 0.0, heading.sin());
            add_surface(&mut map, rotation, normal, 400, &mut rng);
        }
        for _ in 0..300 {
            let normal = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0));
            add_surface(&mut map, rotation, normal, 1, &mut rng);
        }
        map
    }

    #[test]
    fn the_room_is_level_however_the_camera_was_held() {
        let mut rng = Pcg64::seed_from_u64(5);
        for seed in 0..20 {
            let world = Vector3::from_fn(|_, _| rng.random_range(-2.0..2.0));
            let rotation = UnitQuaternion::from_scaled_axis(world);
            let tilt = Vector3::new(
                rng.random_range(-0.9..0.5),
                0.0,
                rng.random_range(-0.3..0.3),
            );
            let camera_up = rotation * UnitQuaternion::from_scaled_axis(tilt) * -Vector3::y();
            let up = up_direction(&room(&rotation, seed), camera_up);
            let error_deg = up.angle(&(rotation * -Vector3::y())).to_degrees();
            assert!(error_deg < 1.0, "{seed}: {error_deg} degrees");
        }
    }

    #[test]
    fn without_order_the_cameras_decide() {
        let up = Vector3::new(0.1, -1.0, 0.2).normalize();
        assert_eq!(up_direction(&Gaussians::default(), up), up);
        assert_eq!(
            up_direction(&Gaussians::default(), Vector3::zeros()),
            -Vector3::y()
        );
        let mut rng = Pcg64::seed_from_u64(1);
        let mut map = Gaussians::default();
        for _ in 0..2000 {
            let normal = loop {
                let normal = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0_f64));
                if normal.norm() < 1.0 {
                    break normal;
                }
            };
            add_surface(&mut map, &UnitQuaternion::identity(), normal, 1, &mut rng);
        }
        assert_eq!(up_direction(&map, up), up);
    }
}
