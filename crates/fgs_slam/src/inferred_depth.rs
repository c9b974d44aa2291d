//! A guess at the depth of pixels where none was measured: panes, dark and shiny things, the shadow
//! beside a near object, the border of a registered depth image.
//!
//! Push and pull over a pyramid (Gortler et al., SIGGRAPH 1996): a hole takes the depth of its
//! nearest surroundings. Where these are both near and far, the far one counts: the shadows that a
//! depth camera leaves lie on the background, and a guess that is too far stands in front of nothing.

use fgs_geom::{Image, has_depth};

/// Depths within this share of the farthest belong to the same surface.
const SAME_SURFACE: f32 = 0.1;

/// Depth in metres at every pixel: as measured, or inferred. 0 everywhere if nothing was measured.
pub fn infer_depth(depth_m: &Image<f32>) -> Image<f32> {
    if depth_m.width() <= 1 && depth_m.height() <= 1 {
        return depth_m.clone();
    }
    let coarser = infer_depth(&halved(depth_m));
    Image::from_fn(depth_m.width(), depth_m.height(), |u, v| {
        let measured = depth_m.at(u, v);
        if has_depth(measured) {
            measured
        } else {
            interpolated(&coarser, u, v)
        }
    })
}

/// Each pixel the farthest surface of four.
fn halved(depth_m: &Image<f32>) -> Image<f32> {
    let (width, height) = (depth_m.width(), depth_m.height());
    Image::from_fn(width.div_ceil(2), height.div_ceil(2), |u, v| {
        let of_four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(du, dv)| {
            let (u, v) = (2 * u + du, 2 * v + dv);
            let depth = if u < width && v < height {
                depth_m.at(u, v)
            } else {
                0.0
            };
            (1.0, depth)
        });
        farthest_surface(of_four)
    })
}

/// Bilinear, at a pixel of the image twice as large.
fn interpolated(coarser: &Image<f32>, u: usize, v: usize) -> f32 {
    // The centre of the fine pixel lies a quarter of a coarse one beside the centre of its own.
    let neighbors = |i: usize, size: usize| {
        let own = (i / 2).min(size - 1);
        let other = if i.is_multiple_of(2) {
            own.saturating_sub(1)
        } else {
            (own + 1).min(size - 1)
        };
        [(0.75, own), (0.25, other)]
    };
    let columns = neighbors(u, coarser.width());
    let rows = neighbors(v, coarser.height());
    let at = |i: usize, j: usize| {
        (
            columns[i].0 * rows[j].0,
            coarser.at(columns[i].1, rows[j].1),
        )
    };
    farthest_surface([at(0, 0), at(1, 0), at(0, 1), at(1, 1)])
}

/// The weighted mean of those depths that lie near the farthest; 0 if there is none.
fn farthest_surface(weighted: [(f32, f32); 4]) -> f32 {
    let measured = || weighted.iter().filter(|(_, depth)| has_depth(*depth));
    let farthest = measured().fold(0.0_f32, |far, (_, depth)| far.max(*depth));
    let (sum, weight) = measured()
        .filter(|(_, depth)| *depth >= (1.0 - SAME_SURFACE) * farthest)
        .fold((0.0, 0.0), |(sum, all), (weight, depth)| {
            (sum + weight * depth, all + weight)
        });
    if weight > 0.0 { sum / weight } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn measured_depth_stays_and_every_hole_is_filled() {
        for (width, height) in [(1, 1), (7, 5), (33, 17), (64, 2)] {
            let depth_m = Image::from_fn(width, height, |u, v| {
                if (u * 7 + v * 3) % 5 == 0 {
                    1.0 + 0.01 * u as f32
                } else {
                    f32::NAN
                }
            });
            let filled = infer_depth(&depth_m);
            for (filled, measured) in filled.data().iter().zip(depth_m.data()) {
                assert!(has_depth(*filled) && (1.0..1.7).contains(filled));
                assert!(!has_depth(*measured) || filled == measured);
            }
        }
        let nothing = infer_depth(&Image::filled(9, 4, 0.0));
        assert!(nothing.data().iter().all(|depth| *depth == 0.0));
    }

    #[test]
    fn a_hole_in_a_slanted_wall_lies_on_the_wall() {
        let wall = |u: usize, v: usize| 2.0 + 0.004 * u as f32 - 0.002 * v as f32;
        let is_hole = |u: usize, v: usize| (20..32).contains(&u) && (10..22).contains(&v);
        let depth_m = Image::from_fn(64, 48, |u, v| if is_hole(u, v) { 0.0 } else { wall(u, v) });
        let filled = infer_depth(&depth_m);
        for (u, v) in [(20, 10), (26, 16), (31, 21)] {
            assert!((filled.at(u, v) / wall(u, v) - 1.0).abs() <= 0.01);
        }
    }

    #[test]
    fn the_shadow_of_a_near_thing_lies_on_the_background() {
        // A box at 1 m before a wall at 3 m; right of the box ten columns without depth.
        let depth_m = Image::from_fn(64, 48, |u, _| match u {
            0..20 => 1.0,
            20..30 => 0.0,
            _ => 3.0,
        });
        let filled = infer_depth(&depth_m);
        let shadow: Vec<f32> = (20..30).map(|u| filled.at(u, 24)).collect();
        let on_wall = shadow.iter().filter(|depth| **depth == 3.0).count();
        // The pixels nearest to the box may belong to it.
        assert!(
            on_wall >= 8 && shadow.iter().all(|depth| [1.0, 3.0].contains(depth)),
            "{shadow:?}"
        );
    }
}
