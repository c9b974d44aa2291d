use nalgebra::{Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::*;

/// A rough surface with a depth step, holes and non-finite pixels.
fn depth_with_everything() -> Image<f32> {
    let mut rng = Pcg64Mcg::seed_from_u64(6);
    Image::from_fn(61, 43, |u, v| {
        let wall = if u + 2 * v < 70 { 1.0 } else { 1.7 };
        let depth = wall + 0.004 * u as f32 - 0.006 * v as f32;
        match rng.random_range(0..12) {
            0 => 0.0,
            1 if u % 7 == 0 => f32::NAN,
            _ => depth + rng.random_range(-0.02..0.02),
        }
    })
}

/// Reference implementation: lists the window's pixels and solves the normal equations in f64;
/// `None` if there is no plane.
fn reference(grid: &DepthGrid, depth_m: &Image<f32>, u: usize, v: usize) -> Option<[f64; 3]> {
    let depth = depth_m
        .get(u, v)
        .filter(|z| *z > 0.0 && *z <= grid.max_depth_m)?;
    let step = grid.window_step_px as i32;
    let reach = grid.window_radius_px as i32 / step;
    let (mut matrix, mut right) = (Matrix3::zeros(), Vector3::zeros());
    let mut samples: Vec<(Vector3<f64>, f64)> = Vec::new();
    for j in -reach..=reach {
        for i in -reach..=reach {
            let (du, dv) = (i * step, j * step);
            let pixel = (u as i32 + du, v as i32 + dv);
            let Some(z) = depth_m.get(pixel.0 as usize, pixel.1 as usize) else {
                continue;
            };
            if (z / depth - 1.0).abs() <= grid.max_depth_step {
                let x = Vector3::new(du.into(), dv.into(), 1.0);
                matrix += x * x.transpose();
                right += x / f64::from(z);
                samples.push((x, 1.0 / f64::from(z)));
            }
        }
    }
    let side = f64::from(2 * reach + 1);
    if samples.len() < 3 || (samples.len() as f64) < grid.min_support * side * side {
        return None;
    }
    let plane = matrix.cholesky()?.solve(&right);
    let squared = samples.iter().map(|(x, r)| (r - plane.dot(x)).powi(2));
    let error = (squared.sum::<f64>() / samples.len() as f64).sqrt() * f64::from(depth);
    (error <= grid.max_fit_error).then(|| plane.into())
}

#[test]
fn equals_the_normal_equations_whatever_the_lane() {
    let depth_m = depth_with_everything();
    for (window_radius_px, window_step_px, max_fit_error) in
        [(4, 2, 0.009), (3, 1, 0.01), (7, 3, 1.0)]
    {
        let grid = DepthGrid {
            window_radius_px,
            window_step_px,
            max_fit_error,
            max_depth_m: 1.75,
            ..DepthGrid::default()
        };
        let (mut found, mut refused) = (0, 0);
        for v in 0..depth_m.height() {
            // The last columns lie outside the image.
            for first in 0..4 {
                let columns: [usize; 16] = std::array::from_fn(|i| first + 4 * i);
                let planes = fit_planes(&grid, &depth_m, columns, v);
                for (u, plane) in columns.into_iter().zip(planes) {
                    let [alone] = fit_planes(&grid, &depth_m, [u], v);
                    let values = plane.map(|p| [p.slope_u, p.slope_v, p.center]);
                    assert_eq!(values, alone.map(|p| [p.slope_u, p.slope_v, p.center]));
                    let expected = reference(&grid, &depth_m, u, v);
                    assert_eq!(values.is_some(), expected.is_some(), "{u} {v}");
                    let (Some(values), Some(expected)) = (values, expected) else {
                        refused += 1;
                        continue;
                    };
                    found += 1;
                    for (value, expected) in values.into_iter().zip(expected) {
                        assert!((value - expected).abs() <= 1e-6, "{value} {expected}");
                    }
                }
            }
        }
        assert!(found > 500 && refused > 200, "{found} {refused}");
    }
}

#[test]
fn three_pixels_give_a_plane_unless_on_a_line() {
    let pixels = |all: &[(usize, usize)]| {
        Image::from_fn(30, 20, |u, v| if all.contains(&(u, v)) { 1.0 } else { 0.0 })
    };
    let grid = DepthGrid {
        min_support: 0.0,
        ..DepthGrid::default()
    };
    let plane = |all: &[(usize, usize)]| fit_planes(&grid, &pixels(all), [12], 9)[0];
    assert!(plane(&[(12, 9), (14, 9)]).is_none());
    assert!(plane(&[(12, 9), (14, 9), (16, 9)]).is_none());
    assert!(plane(&[(12, 9), (14, 11), (16, 13), (10, 7)]).is_none());
    assert!((plane(&[(12, 9), (14, 9), (12, 7)]).unwrap().center - 1.0).abs() <= 1e-6);
}
