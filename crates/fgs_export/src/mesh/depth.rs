//! The depth image of a map's surface.
//!
//! Rendered depth is too near, by several millimetres in an optimised map, because optimisation leaves
//! disks tilted: in a synthetic room by 36 degrees in the median, and 9 mm become 0.5 mm once the disks
//! are turned into the true surface. Their centres are right on average, so the rendered depth is
//! shifted, region by region, to where these are.

use fgs_geom::{Image, View};
use fgs_splat::{Gaussians, Rasterizer, Rendered};
use nalgebra::Vector3;

use crate::quantities::is_surface;

/// Below this the background shows through: there is no surface, or its edge.
const MIN_ALPHA: f32 = 0.8;

/// Side of a region, pixels: some tens of gaussians.
const REGION: usize = 16;

/// A view of the surface.
pub(super) struct SurfaceImage {
    pub color: Image<[f32; 3]>,
    /// Along z, metres; 0 where there is no surface, and beside steps in depth, where front and
    /// background are blended.
    pub depth_m: Image<f32>,
}

impl SurfaceImage {
    /// Steps of depth are those of more than `max_step_m`; gaussians farther than that from what is
    /// rendered belong to another surface.
    pub fn new(
        rasterizer: &mut Rasterizer,
        gaussians: &Gaussians,
        view: &View,
        max_step_m: f32,
    ) -> Self {
        let pass = rasterizer.render(gaussians, view);
        let depth_m = smooth_depth(pass.rendered(), max_step_m);
        let offsets = CenterOffsets::new(gaussians, view, &depth_m, max_step_m);
        let depth_m = Image::from_fn(depth_m.width(), depth_m.height(), |u, v| {
            match depth_m.at(u, v) {
                0.0 => 0.0,
                depth_m => depth_m + offsets.at(u, v),
            }
        });
        let color = pass.rendered().color.clone();
        Self { color, depth_m }
    }
}

fn smooth_depth(rendered: &Rendered, max_step_m: f32) -> Image<f32> {
    let alpha = &rendered.alpha;
    let (width, height) = (alpha.width(), alpha.height());
    let depth_m = Image::from_fn(width, height, |u, v| {
        let is_surface = alpha.at(u, v) >= MIN_ALPHA;
        if is_surface {
            rendered.surface_depth_m(u, v)
        } else {
            0.0
        }
    });
    Image::from_fn(width, height, |u, v| {
        let here = depth_m.at(u, v);
        let neighbors = [
            (u.wrapping_sub(1), v),
            (u + 1, v),
            (u, v.wrapping_sub(1)),
            (u, v + 1),
        ];
        let mut neighbors = neighbors.into_iter().filter_map(|(u, v)| depth_m.get(u, v));
        let is_smooth = neighbors.all(|depth| (depth - here).abs() <= max_step_m);
        if is_smooth { here } else { 0.0 }
    })
}

/// How much farther than the rendered surface gaussians are, on average over each region.
struct CenterOffsets {
    /// Sum and number.
    regions: Image<(f32, f32)>,
}

impl CenterOffsets {
    fn new(gaussians: &Gaussians, view: &View, depth_m: &Image<f32>, max_offset_m: f32) -> Self {
        let regions = [depth_m.width(), depth_m.height()].map(|size| size.div_ceil(REGION));
        let mut regions = Image::filled(regions[0], regions[1], (0.0, 0.0));
        let camera_from_world = view.world_from_camera.inverse();
        for i in (0..gaussians.len()).filter(|i| is_surface(gaussians, *i)) {
            let center = Vector3::from(gaussians.means[i]).cast::<f64>();
            let center = camera_from_world.transform(&center);
            let Some(pixel) = view.camera.project(&center) else {
                continue;
            };
            let Some(depth_m) = depth_at(depth_m, pixel.x as f32, pixel.y as f32) else {
                continue;
            };
            let offset_m = center.z as f32 - depth_m;
            if offset_m.abs() <= max_offset_m {
                let (u, v) = (pixel.x as usize / REGION, pixel.y as usize / REGION);
                let (sum, count) = regions.at(u, v);
                regions.set(u, v, (sum + offset_m, count + 1.0));
            }
        }
        Self { regions }
    }

    /// Between the middles of regions sums and numbers are interpolated. 0 without gaussians.
    fn at(&self, u: usize, v: usize) -> f32 {
        let along = |pixel: usize, regions: usize| {
            let at = (pixel as f32 + 0.5) / REGION as f32 - 0.5;
            let first = at.max(0.0) as usize;
            (
                first,
                (first + 1).min(regions - 1),
                (at - first as f32).max(0.0),
            )
        };
        let (left, right, s) = along(u, self.regions.width());
        let (top, bottom, t) = along(v, self.regions.height());
        let corners = [
            (left, top, (1.0 - s) * (1.0 - t)),
            (right, top, s * (1.0 - t)),
            (left, bottom, (1.0 - s) * t),
            (right, bottom, s * t),
        ];
        let (mut sum, mut count) = (0.0, 0.0);
        for (u, v, weight) in corners {
            let region = self.regions.at(u, v);
            sum += weight * region.0;
            count += weight * region.1;
        }
        if count > 0.0 { sum / count } else { 0.0 }
    }
}

/// The depth at a point between pixel centres, bilinearly; `None` beside pixels without depth and
/// outside the image.
#[inline]
pub(super) fn depth_at(depth_m: &Image<f32>, u: f32, v: f32) -> Option<f32> {
    if !(u >= 0.0 && v >= 0.0) {
        return None;
    }
    let (left, top) = (u as usize, v as usize);
    let corner = |u: usize, v: usize| depth_m.get(u, v).filter(|depth| *depth > 0.0);
    let (a, b) = (corner(left, top)?, corner(left + 1, top)?);
    let (c, d) = (corner(left, top + 1)?, corner(left + 1, top + 1)?);
    let (s, t) = (u - left as f32, v - top as f32);
    Some((1.0 - t) * ((1.0 - s) * a + s * b) + t * ((1.0 - s) * c + s * d))
}
