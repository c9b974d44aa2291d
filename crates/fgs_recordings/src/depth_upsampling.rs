//! Depth brought to a larger image.
//!
//! Between four measurements of one surface depth is interpolated, in its inverse: that of a plane is
//! linear in the image, so that planes stay planes. Where one of the four is missing, or they lie on both
//! sides of an edge, the nearest is taken as it is: a value between foreground and background would be a
//! surface where nothing is.

use fgs_geom::{Image, has_depth};

/// Depths of one surface differ by less than this factor between neighbouring measurements: at a phone's
/// four pixels a degree, a floor seen at 5 degrees.
const MAX_STEP: f32 = 1.05;

/// Where coordinates along one axis lie in another image: `scale * at + offset`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Axis {
    scale: f64,
    offset: f64,
}

impl Axis {
    /// From one camera's (focal length, principal point) to another's.
    pub fn between((f, c): (f64, f64), (to_f, to_c): (f64, f64)) -> Self {
        if (f, c) == (to_f, to_c) {
            // Exactly.
            return Self {
                scale: 1.0,
                offset: 0.0,
            };
        }
        let scale = to_f / f;
        Self {
            scale,
            offset: to_c - scale * c,
        }
    }

    /// The same place in an image that is `factor` times as large.
    pub fn scaled(self, factor: f64) -> Self {
        Self {
            scale: factor * self.scale,
            offset: factor * (self.offset + 0.5) - 0.5,
        }
    }

    pub fn at(self, place: f64) -> f64 {
        self.scale * place + self.offset
    }
}

/// Neighbours along one axis.
#[derive(Clone, Copy)]
struct Between {
    before: usize,
    after: usize,
    /// The way from the one to the other, 0 to 1.
    way: f32,
}

impl Between {
    /// `None` outside the image, which ends half a pixel beyond the outermost centres.
    fn of(place: f64, size: usize) -> Option<Self> {
        let last = size as f64 - 1.0;
        if !(-0.5..=last + 0.5).contains(&place) {
            return None;
        }
        let place = place.clamp(0.0, last);
        let before = place as usize;
        Some(Self {
            before,
            after: (before + 1).min(size - 1),
            way: (place - before as f64) as f32,
        })
    }

    fn nearest(self) -> usize {
        if self.way < 0.5 {
            self.before
        } else {
            self.after
        }
    }
}

/// A depth image of `size`, whose pixels lie in `depth_m` by `axes`; 0 where nothing was measured.
pub(crate) fn upsampled(
    depth_m: &Image<f32>,
    (width, height): (usize, usize),
    [x, y]: [Axis; 2],
) -> Image<f32> {
    let places = |axis: Axis, count: usize, size: usize| -> Vec<Option<Between>> {
        (0..count)
            .map(|at| Between::of(axis.at(at as f64), size))
            .collect()
    };
    let columns = places(x, width, depth_m.width());
    let rows = places(y, height, depth_m.height());
    let mut image = Image::filled(width, height, 0.0);
    for (pixels, row) in image.data_mut().chunks_exact_mut(width).zip(rows) {
        let Some(row) = row else { continue };
        let (upper, lower) = (depth_m.row(row.before), depth_m.row(row.after));
        let nearest = depth_m.row(row.nearest());
        for (pixel, column) in pixels.iter_mut().zip(&columns) {
            let Some(column) = *column else { continue };
            let four = [
                upper[column.before],
                upper[column.after],
                lower[column.before],
                lower[column.after],
            ];
            let measured = nearest[column.nearest()];
            *pixel = if column.way == 0.0 && row.way == 0.0 {
                measured
            } else if is_one_surface(&four) {
                interpolated(&four, column.way, row.way)
            } else {
                measured
            };
            if !has_depth(*pixel) {
                *pixel = 0.0;
            }
        }
    }
    image
}

fn is_one_surface(four: &[f32; 4]) -> bool {
    let nearest = four.iter().copied().fold(f32::INFINITY, f32::min);
    let farthest = four.iter().copied().fold(0.0, f32::max);
    four.iter().all(|depth| has_depth(*depth)) && farthest <= MAX_STEP * nearest
}

fn interpolated(four: &[f32; 4], a: f32, b: f32) -> f32 {
    let [p, q, r, s] = four.map(|depth| 1.0 / depth);
    let upper = p + a * (q - p);
    let lower = r + a * (s - r);
    1.0 / (upper + b * (lower - upper))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// From an image of `size` to one `n` times as large.
    fn enlarged(depth_m: &Image<f32>, n: usize) -> Image<f32> {
        let axis = Axis::between((1.0, 0.0), (1.0, 0.0)).scaled(1.0 / n as f64);
        let size = (n * depth_m.width(), n * depth_m.height());
        upsampled(depth_m, size, [axis; 2])
    }

    #[test]
    fn planes_stay_planes() {
        let inverse = |u: f64, v: f64| 0.4 + 0.003 * u - 0.002 * v;
        let plane = Image::from_fn(20, 16, |u, v| (1.0 / inverse(u as f64, v as f64)) as f32);
        let large = enlarged(&plane, 4);
        // The outermost half pixel is the outermost measurement.
        for v in 2..62 {
            for u in 2..78 {
                let at = |place: usize| (place as f64 + 0.5) / 4.0 - 0.5;
                let expected = (1.0 / inverse(at(u), at(v))) as f32;
                assert!((large.at(u, v) - expected).abs() < 2e-6, "{u} {v}");
            }
        }
        assert_eq!(large.at(0, 0), plane.at(0, 0));
    }

    #[test]
    fn nothing_lies_between_foreground_and_background() {
        let edge = Image::from_fn(9, 9, |u, v| if u + v < 9 { 1.0 } else { 2.0 });
        let large = enlarged(&edge, 5);
        assert!(large.data().iter().all(|depth| [1.0, 2.0].contains(depth)));
    }

    #[test]
    fn holes_stay_as_large_as_they_are() {
        let mut depth = Image::filled(5, 5, 1.5);
        depth.set(2, 2, 0.0);
        depth.set(4, 4, f32::NAN);
        let large = enlarged(&depth, 4);
        let holes = large.data().iter().filter(|depth| **depth == 0.0).count();
        assert_eq!(holes, 32);
        assert!(
            large
                .data()
                .iter()
                .all(|depth| *depth == 0.0 || (depth - 1.5).abs() < 1e-6)
        );
    }

    #[test]
    fn outside_there_is_nothing() {
        let depth = Image::filled(4, 4, 1.0);
        let axis = Axis {
            scale: 1.0,
            offset: -2.0,
        };
        let moved = upsampled(&depth, (8, 8), [axis; 2]);
        let measured = moved.data().iter().filter(|depth| **depth == 1.0).count();
        assert_eq!(measured, 16);
    }
}
