//! The depth image of a rendered surface.

use fgs_geom::Image;
use fgs_splat::Rendered;

/// Below this the background shows through: there is no surface, or its edge.
const MIN_ALPHA: f32 = 0.8;

/// Depth along z, metres; 0 where there is no surface, and beside steps of more than `max_step_m`, where
/// front and background are blended.
pub(super) fn surface_depth(rendered: &Rendered, max_step_m: f32) -> Image<f32> {
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
