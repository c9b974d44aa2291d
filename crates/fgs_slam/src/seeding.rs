//! New gaussians from a frame (paper, Sec. III-A, Eq. 10 and 11): small dense disks where the image
//! has detail, large sparse ones elsewhere, and only in the missing region.
//!
//! Differs from the paper: a disk lies on the surface where the depth gives a reliable normal, and
//! is stretched along its tilt so that its image stays round; the paper's faces the camera.

use fgs_geom::{Image, RgbdFrame, Se3, has_depth};
use fgs_gicp::DepthGrid;
use fgs_splat::{Gaussians, SH0_FACTOR, Seeds, SparseId};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::config::{Disks, SeedingConfig};
use crate::keyframes::NewPoint;
use crate::surface::seeding_surface;

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
    /// For a frame, its pose and its detail mask M_h.
    pub fn new(
        frame: &'a RgbdFrame,
        world_from_camera: Se3,
        detail: &'a Image<bool>,
        config: &'a SeedingConfig,
    ) -> Self {
        Self {
            frame,
            world_from_camera,
            detail,
            config,
            surface: seeding_surface(),
        }
    }

    /// Seeds on the pixels of the two grids that lie in `missing`, Eq. (10), and on those that join
    /// the sparse map. A pixel that is both gets one gaussian that serves both maps.
    pub fn seeds(&self, missing: &Image<bool>, new_points: &[NewPoint]) -> Seeds {
        let (width, height) = (missing.width(), missing.height());
        let mut sparse: Image<Option<SparseId>> = Image::filled(width, height, None);
        for point in new_points {
            sparse.set(point.u, point.v, Some(point.id));
        }
        let mut seeds = Seeds::default();
        for v in 0..height {
            for u in 0..width {
                let sparse_id = sparse.at(u, v);
                let dense = missing.at(u, v) && self.is_on_grid(u, v);
                if (dense || sparse_id.is_some()) && has_depth(self.frame.depth_m.at(u, v)) {
                    self.plant(u, v, &mut seeds.gaussians);
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
        u.is_multiple_of(stride) && v.is_multiple_of(stride)
    }

    fn plant(&self, u: usize, v: usize, gaussians: &mut Gaussians) {
        let depth_m = f64::from(self.frame.depth_m.at(u, v));
        let camera = &self.frame.camera;
        let point = camera.unproject(u as f64, v as f64, depth_m);
        let ray = point.normalize();
        let normal = match self.config.disks {
            Disks::View => -ray,
            Disks::Normal => self
                .surface
                .surface_point(&self.frame.depth_m, camera, u, v)
                .map_or(-ray, |surface| surface.normal),
        };
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
        gaussians.means.push([mean.x as f32, mean.y as f32, mean.z as f32]);
        gaussians
            .quats
            .push([q.w as f32, q.i as f32, q.j as f32, q.k as f32]);
        gaussians.log_scales.push([
            stretched_m.ln() as f32,
            sigma_m.ln() as f32,
            THICKNESS_M.ln(),
        ]);
        gaussians.opacity_logits.push((OPACITY / (1.0 - OPACITY)).ln());
        let rgb = self.frame.color.at(u, v);
        gaussians
            .sh
            .push(rgb.map(|c| ((f64::from(c) / 255.0 - 0.5) / SH0_FACTOR) as f32));
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
