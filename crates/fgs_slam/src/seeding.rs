//! New gaussians from a frame (paper, Sec. III-A, Eq. 10 and 11): small dense disks where the image
//! has detail, large sparse ones elsewhere, and only in the missing region.
//!
//! Where no depth was measured it is inferred from around the hole ([`infer_depth`]), and the
//! gaussian is marked: it will yield to what is measured there later.
//!
//! Differs from the paper: the paper leaves holes empty; a disk lies on the surface where the depth
//! gives a reliable normal, and is stretched along its tilt so that its image stays round; the
//! paper's faces the camera. Disks are a fifth smaller than the paper's, which blur what they cover.

use fgs_geom::{Image, RgbdFrame, Se3, has_depth};
use fgs_gicp::DepthGrid;
use fgs_splat::{Gaussians, SH0_FACTOR, Seeds, SparseId};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::config::SeedingConfig;
use crate::inferred_depth::infer_depth;
use crate::keyframes::NewPoint;

/// Opacity of a new gaussian: the largest the rasteriser keeps, since a measured surface is opaque.
const OPACITY: f32 = 0.99;

/// Standard deviation along the flat axis, metres: thin, but not singular in single precision.
const THICKNESS_M: f32 = 5e-6;

/// A disk seen at a flatter angle than this cosine is not stretched any more: its normal is too
/// uncertain.
const MIN_COSINE: f64 = 0.3;

/// Plants gaussians on a frame's pixels.
pub struct Seeder<'a> {
    frame: &'a RgbdFrame,
    world_from_camera: Se3,
    detail: &'a Image<bool>,
    config: &'a SeedingConfig,
    surface: DepthGrid,
}

impl<'a> Seeder<'a> {
    /// For a frame, its pose, its detail mask M_h and the measurement of its surfaces.
    pub fn new(
        frame: &'a RgbdFrame,
        world_from_camera: Se3,
        detail: &'a Image<bool>,
        config: &'a SeedingConfig,
        surface: DepthGrid,
    ) -> Self {
        Self {
            frame,
            world_from_camera,
            detail,
            config,
            surface,
        }
    }

    /// Seeds on the pixels of the two grids that lie in `missing`, Eq. (10), and on those that join
    /// the sparse map. A pixel that is both gets one gaussian that serves both maps; a pixel whose
    /// colour the camera did not see gets none.
    pub fn seeds(&self, missing: &Image<bool>, new_points: &[NewPoint]) -> Seeds {
        let (width, height) = (missing.width(), missing.height());
        let mut sparse: Image<Option<SparseId>> = Image::filled(width, height, None);
        for point in new_points {
            sparse.set(point.u, point.v, Some(point.id));
        }
        let measured_m = &self.frame.depth_m;
        let filled_m = self.config.fill_holes.then(|| infer_depth(measured_m));
        let depth_m = filled_m.as_ref().unwrap_or(measured_m);
        let mut seeds = Seeds::default();
        for v in 0..height {
            for u in 0..width {
                let sparse_id = sparse.at(u, v);
                let dense = missing.at(u, v) && self.is_on_grid(u, v);
                if (dense || sparse_id.is_some())
                    && has_depth(depth_m.at(u, v))
                    && self.frame.has_color(u, v)
                {
                    self.plant(u, v, depth_m.at(u, v), &mut seeds.gaussians);
                    seeds.sparse_ids.push(sparse_id);
                }
            }
        }
        seeds
    }

    fn is_on_grid(&self, u: usize, v: usize) -> bool {
        let stride = if self.detail.at(u, v) {
            self.config.high_stride_px
        } else {
            self.config.low_stride_px
        };
        // Offset like the tracking grid, so that pixels of both are shared.
        u % stride == stride / 2 && v % stride == stride / 2
    }

    fn plant(&self, u: usize, v: usize, depth_m: f32, gaussians: &mut Gaussians) {
        let depth_m = f64::from(depth_m);
        let camera = &self.frame.camera;
        let point = camera.unproject(u as f64, v as f64, depth_m);
        let ray = point.normalize();
        let normal = self
            .surface
            .surface_point(&self.frame.depth_m, camera, u, v)
            .map_or(-ray, |surface| surface.normal);
        let cosine = normal.dot(&ray).abs();
        let camera_from_disk = disk_axes(&normal, &ray);
        let world_from_disk = self.world_from_camera.rotation * camera_from_disk;
        let mean = self.world_from_camera.transform(&point);
        // Eq. (11)
        let sigma_px = if self.detail.at(u, v) {
            self.config.high_sigma_px
        } else {
            self.config.low_sigma_px
        };
        let focal_px = (camera.intrinsics.fx * camera.intrinsics.fy).sqrt();
        let sigma_m = sigma_px * depth_m / focal_px;
        let stretched_m = sigma_m / cosine.max(MIN_COSINE);
        let q = world_from_disk.quaternion();
        gaussians
            .means
            .push([mean.x as f32, mean.y as f32, mean.z as f32]);
        gaussians
            .quats
            .push([q.w as f32, q.i as f32, q.j as f32, q.k as f32]);
        gaussians.log_scales.push([
            stretched_m.ln() as f32,
            sigma_m.ln() as f32,
            THICKNESS_M.ln(),
        ]);
        gaussians
            .opacity_logits
            .push((OPACITY / (1.0 - OPACITY)).ln());
        let rgb = self.frame.color.at(u, v);
        gaussians
            .sh
            .push(rgb.map(|c| ((f64::from(c) / 255.0 - 0.5) / SH0_FACTOR) as f32));
        let measured = has_depth(self.frame.depth_m.at(u, v));
        gaussians.inferred.push(!measured);
    }
}

/// The rotation whose third axis is `normal` and whose first lies in the surface along its tilt
/// away from the viewing `ray` (both unit vectors).
fn disk_axes(normal: &Vector3<f64>, ray: &Vector3<f64>) -> UnitQuaternion<f64> {
    let tilt = ray - normal * normal.dot(ray);
    let first = tilt.try_normalize(1e-3).unwrap_or_else(|| {
        // Seen head on, any axis in the surface will do: the one nearest to x or y.
        let axis = if normal.x.abs() < 0.7 {
            Vector3::x()
        } else {
            Vector3::y()
        };
        (axis - normal * normal.dot(&axis)).normalize()
    });
    let axes = Matrix3::from_columns(&[first, normal.cross(&first), *normal]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes))
}

#[cfg(test)]
mod tests {
    use fgs_geom::{Camera, FrameIndex, Intrinsics};

    use super::*;

    const W: usize = 48;
    const H: usize = 40;

    /// A wall through (0, 0, 2) with the given normal, each pixel of its own colour, seen by a
    /// camera with an off-centre principal point.
    fn wall(normal: Vector3<f64>) -> RgbdFrame {
        let intrinsics = Intrinsics {
            fx: 50.0,
            fy: 50.0,
            cx: 20.0,
            cy: 22.5,
        };
        let camera = Camera::new(W, H, intrinsics).unwrap();
        let depth_m = Image::from_fn(W, H, |u, v| {
            (2.0 * normal.z / normal.dot(&camera.ray(u as f64, v as f64))) as f32
        });
        let color = Image::from_fn(W, H, |u, v| [u as u8, v as u8, 255]);
        RgbdFrame::new(FrameIndex(0), 0.0, color, depth_m, camera).unwrap()
    }

    fn pose() -> Se3 {
        Se3::exp(&nalgebra::Vector6::new(0.4, -0.7, 0.2, 1.0, -2.0, 0.5))
    }

    fn surface(frame: &RgbdFrame) -> DepthGrid {
        let config = crate::config::SlamConfig::default();
        crate::surface::seeding_surface(&config, &frame.camera)
    }

    fn axes(gaussians: &Gaussians, i: usize) -> Matrix3<f64> {
        let [w, x, y, z] = gaussians.quats[i].map(f64::from);
        UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z))
            .to_rotation_matrix()
            .into_inner()
    }

    #[test]
    fn detail_is_dense_and_the_rest_sparse_and_only_the_missing_is_seeded() {
        let frame = wall(Vector3::new(0.0, 0.0, -1.0));
        let detail = Image::from_fn(W, H, |u, _| u < 24);
        let missing = Image::from_fn(W, H, |_, v| v < 20);
        let config = SeedingConfig::default();
        let seeder = Seeder::new(&frame, pose(), &detail, &config, surface(&frame));
        let seeds = seeder.seeds(&missing, &[]);
        assert_eq!(seeds.gaussians.len(), 12 * 10 + 6 * 5);
        assert!(seeds.sparse_ids.iter().all(Option::is_none));
        let of_sigma = |sigma_m: f32| {
            let sigmas = seeds.gaussians.log_scales.iter().map(|log| log[1].exp());
            sigmas.filter(|s| (s / sigma_m - 1.0).abs() <= 1e-5).count()
        };
        // Eq. (11): alpha d / f, at 2 m and 50 px focal length.
        let sigma_m = |sigma_px: f64| (sigma_px * 2.0 / 50.0) as f32;
        assert_eq!(of_sigma(sigma_m(config.high_sigma_px)), 12 * 10);
        assert_eq!(of_sigma(sigma_m(config.low_sigma_px)), 6 * 5);
    }

    #[test]
    fn a_pixel_of_both_maps_gets_one_gaussian() {
        let frame = wall(Vector3::new(0.0, 0.0, -1.0));
        let detail = Image::filled(W, H, false);
        let missing = Image::from_fn(W, H, |_, v| v < 4);
        let config = SeedingConfig::default();
        let seeder = Seeder::new(&frame, pose(), &detail, &config, surface(&frame));
        let points = [(10, 2, 7), (11, 2, 8), (10, 30, 9)].map(|(u, v, id)| NewPoint {
            u,
            v,
            id: SparseId(id),
        });
        let seeds = seeder.seeds(&missing, &points);
        assert_eq!(seeds.gaussians.len(), W / 4 + 2);
        let ids: Vec<_> = seeds.sparse_ids.iter().flatten().map(|id| id.0).collect();
        assert_eq!(ids, [7, 8, 9]);
    }

    #[test]
    fn disks_lie_on_the_surface_at_the_measured_point() {
        let normal = Vector3::new(0.6, -0.3, -1.0).normalize();
        let frame = wall(normal);
        let detail = Image::filled(W, H, true);
        let missing = Image::filled(W, H, true);
        let config = SeedingConfig::default();
        let seeds =
            Seeder::new(&frame, pose(), &detail, &config, surface(&frame)).seeds(&missing, &[]);
        let camera_from_world = pose().inverse();
        let gaussians = &seeds.gaussians;
        for i in 0..gaussians.len() {
            let rgb = gaussians.sh[i].map(|sh| 255.0 * (0.5 + SH0_FACTOR * f64::from(sh)));
            let mean = Vector3::from(gaussians.means[i]).cast();
            let pixel = frame
                .camera
                .project(&camera_from_world.transform(&mean))
                .unwrap();
            assert!((pixel.x - rgb[0]).abs() <= 1e-3 && (pixel.y - rgb[1]).abs() <= 1e-3);
            assert!((rgb[2] - 255.0).abs() <= 1e-3);
            let (u, v) = (rgb[0].round() as usize, rgb[1].round() as usize);
            if (8..W - 8).contains(&u) && (8..H - 8).contains(&v) {
                let rotation = camera_from_world.rotation.to_rotation_matrix();
                let axes = rotation.matrix() * axes(gaussians, i);
                assert!((axes.column(2) - normal).amax() <= 1e-3, "({u}, {v})");
                let ray = frame.camera.ray(u as f64, v as f64).normalize();
                // Stretched along the tilt, round across it.
                let tilt = (ray - normal * normal.dot(&ray)).normalize();
                assert!((axes.column(0) - tilt).amax() <= 2e-2, "({u}, {v})");
                let ratio = (gaussians.log_scales[i][0] - gaussians.log_scales[i][1]).exp();
                assert!((f64::from(ratio) * normal.dot(&ray).abs() - 1.0).abs() <= 1e-3);
            }
        }
    }

    #[test]
    fn pixels_without_depth_are_seeded_at_the_depth_around_them() {
        let mut frame = wall(Vector3::new(0.0, 0.0, -1.0));
        frame.depth_m.set(1, 1, 0.0);
        frame.depth_m.set(3, 1, f32::NAN);
        let detail = Image::filled(W, H, true);
        let missing = Image::filled(W, H, true);
        let config = SeedingConfig::default();
        let seeds = |frame: &RgbdFrame| {
            Seeder::new(frame, pose(), &detail, &config, surface(frame)).seeds(&missing, &[])
        };
        let gaussians = seeds(&frame).gaussians;
        assert_eq!(gaussians.len(), W / 2 * H / 2);
        // The wall is at 2 m all around.
        for (i, u) in [(0, 1), (1, 3)] {
            let expected = pose().transform(&frame.camera.unproject(f64::from(u), 1.0, 2.0));
            let mean = gaussians.means[i].map(f64::from);
            assert!((Vector3::from(mean) - expected).amax() <= 1e-5);
        }
        let expected = (0..gaussians.len()).map(|i| i < 2);
        assert!(gaussians.inferred.iter().copied().eq(expected));
        // With nothing measured at all there is nothing to infer from.
        frame.depth_m = Image::filled(W, H, 0.0);
        assert_eq!(seeds(&frame).gaussians.len(), 0);
    }

    #[test]
    fn pixels_whose_color_was_not_seen_are_left_out() {
        let seen = Image::from_fn(W, H, |u, _| u >= 10);
        let frame = wall(Vector3::new(0.0, 0.0, -1.0));
        let frame = frame.with_color_valid(std::sync::Arc::new(seen)).unwrap();
        let detail = Image::filled(W, H, true);
        let missing = Image::filled(W, H, true);
        let config = SeedingConfig::default();
        let seeder = Seeder::new(&frame, pose(), &detail, &config, surface(&frame));
        let points = [(2, 7), (10, 8)].map(|(u, id)| NewPoint {
            u,
            v: 4,
            id: SparseId(id),
        });
        let seeds = seeder.seeds(&missing, &points);
        // Column 10 is off the grid of odd columns.
        assert_eq!(seeds.gaussians.len(), (W - 10) / 2 * H / 2 + 1);
        let ids: Vec<_> = seeds.sparse_ids.iter().flatten().map(|id| id.0).collect();
        assert_eq!(ids, [8]);
    }
}
