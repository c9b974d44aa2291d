use fgs_geom::Intrinsics;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::*;

fn camera() -> Camera {
    let intrinsics = Intrinsics {
        fx: 80.0,
        fy: 95.0,
        cx: 31.3,
        cy: 52.8,
    };
    Camera::new(97, 73, intrinsics).unwrap()
}

/// Depth along z of the plane `normal . p = -distance`.
fn plane_depth(normal: &Vector3<f64>, distance: f64) -> Image<f32> {
    let camera = camera();
    Image::from_fn(camera.width, camera.height, |u, v| {
        (-distance / normal.dot(&camera.ray(u as f64, v as f64))) as f32
    })
}

fn normals() -> [Vector3<f64>; 4] {
    [
        Vector3::new(0.0, 0.0, -1.0),
        Vector3::new(0.5, 0.1, -1.0).normalize(),
        Vector3::new(-0.2, 0.7, -1.0).normalize(),
        Vector3::new(-0.4, -0.5, -0.9).normalize(),
    ]
}

#[test]
fn a_plane_is_found_exactly_up_to_the_border() {
    for normal in normals() {
        let grid = DepthGrid {
            stride_px: 7,
            min_support: 0.2,
            ..DepthGrid::default()
        };
        let points = grid.surface_points(&plane_depth(&normal, 2.0), &camera());
        assert_eq!(points.len(), 14 * 10);
        for point in points {
            assert!((point.normal - normal).norm() <= 2e-5, "{point:?}");
            let ray = camera().ray(point.u as f64, point.v as f64);
            assert!((point.fitted - ray * point.fitted.z).norm() <= 1e-12);
            assert!((point.fitted - point.measured).norm() <= 1e-5);
            assert!((normal.dot(&point.fitted) + 2.0).abs() <= 1e-5);
        }
    }
}

#[test]
fn the_fit_averages_noise_out() {
    let mut rng = Pcg64Mcg::seed_from_u64(4);
    let mut depth = plane_depth(&normals()[1], 2.0);
    for z in depth.data_mut() {
        *z += rng.random_range(-0.01..0.01);
    }
    let points = DepthGrid::default().surface_points(&depth, &camera());
    let rms = |position: fn(&SurfacePoint) -> Vector3<f64>| {
        let squared = points
            .iter()
            .map(|p| (normals()[1].dot(&position(p)) + 2.0).powi(2));
        (squared.sum::<f64>() / points.len() as f64).sqrt()
    };
    let (measured, fitted) = (rms(|p| p.measured), rms(|p| p.fitted));
    // The mean of 25 samples has a fifth of their error; windows at the border have fewer samples.
    assert!(fitted <= 0.3 * measured, "{fitted} {measured}");
}

#[test]
fn depth_steps_do_not_bend_normals() {
    let normal = normals()[2];
    let (near, far) = (plane_depth(&normal, 2.0), plane_depth(&normal, 2.5));
    let depth = Image::from_fn(near.width(), near.height(), |u, v| {
        if u + v / 2 < 60 {
            near.at(u, v)
        } else {
            far.at(u, v)
        }
    });
    let grid = DepthGrid {
        stride_px: 1,
        min_support: 0.4,
        ..DepthGrid::default()
    };
    let points = grid.surface_points(&depth, &camera());
    assert!(points.len() > 6500, "{}", points.len());
    for point in points {
        assert!((point.normal - normal).norm() <= 1e-4, "{point:?}");
    }
}

#[test]
fn unreliable_surfaces_are_refused() {
    let (camera, grid) = (camera(), DepthGrid::default());
    // A crease: two planes that meet at column 40.
    let crease = Image::from_fn(camera.width, camera.height, |u, _| {
        1.0 + 0.01 * (u as f32 - 40.0).abs()
    });
    let strict = DepthGrid {
        max_fit_error: 0.003,
        ..grid
    };
    assert!(strict.surface_point(&crease, &camera, 40, 30).is_none());
    assert!(strict.surface_point(&crease, &camera, 60, 30).is_some());
    // Grazing incidence: the ray lies nearly in the plane.
    let grazing = plane_depth(&Vector3::new(1.0, 0.0, -0.05).normalize(), 0.5);
    assert!(grid.surface_point(&grazing, &camera, 10, 30).is_none());
    // Beyond the depth limit, without depth, isolated, outside the image.
    let far = DepthGrid {
        max_depth_m: 1.5,
        ..grid
    };
    let wall = plane_depth(&normals()[0], 2.0);
    assert!(grid.surface_point(&wall, &camera, 30, 30).is_some());
    assert!(far.surface_point(&wall, &camera, 30, 30).is_none());
    assert!(grid.surface_point(&wall, &camera, 97, 30).is_none());
    for none in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let mut hole = wall.clone();
        hole.set(30, 30, none);
        assert!(grid.surface_point(&hole, &camera, 30, 30).is_none());
        let mut alone = Image::filled(camera.width, camera.height, none);
        alone.set(30, 30, 1.0);
        assert!(grid.surface_points(&alone, &camera).is_empty());
    }
}

#[test]
fn images_smaller_than_the_window() {
    for (width, height) in [(0, 0), (1, 1), (3, 2)] {
        let depth = Image::filled(width, height, 1.0);
        let grid = DepthGrid {
            stride_px: 0,
            window_step_px: 0,
            ..DepthGrid::default()
        };
        assert!(grid.surface_points(&depth, &camera()).is_empty());
    }
}
