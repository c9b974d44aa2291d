//! FAST corners (Rosten and Drummond 2006) of one image, ranked by Shi and Tomasi's measure.
//!
//! The threshold of a cell of the image follows from its contrast, so that dark, dim and blurred
//! images give corners too, and gain and offset of the brightness change nothing.

use std::ops::Range;

use fgs_geom::Image;

/// Corners keep this distance from the border: what is around them is described.
pub(crate) const BORDER: usize = 16;

/// Side of the cells among which corners are spread, pixels.
const CELL: usize = 64;

/// The difference to its circle that makes a corner, as a share of the contrast of its cell, ...
const MIN_SHARE_OF_CONTRAST: f64 = 0.1;

/// ... and at least, in 8-bit steps: less is noise.
const MIN_DIFFERENCE: u8 = 5;

/// A corner is the best within this many columns and rows.
const SEPARATION: usize = 2;

/// A corner of one image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Corner {
    pub u: usize,
    pub v: usize,
    /// The smaller eigenvalue of the structure tensor.
    pub score: f32,
    /// How many corners of the same cell are better.
    pub rank: usize,
}

/// Bresenham's circle of radius 3, clockwise from the top.
const CIRCLE: [(isize, isize); 16] = [
    (0, -3),
    (1, -3),
    (2, -2),
    (3, -1),
    (3, 0),
    (3, 1),
    (2, 2),
    (1, 3),
    (0, 3),
    (-1, 3),
    (-2, 2),
    (-3, 1),
    (-3, 0),
    (-3, -1),
    (-2, -2),
    (-1, -3),
];

/// The corners of an image, each the best within [`SEPARATION`] pixels, by rank.
pub(crate) fn corners(image: &Image<u8>) -> Vec<Corner> {
    let (width, height) = (image.width(), image.height());
    if width <= 2 * BORDER || height <= 2 * BORDER {
        return Vec::new();
    }
    let mut candidates = Vec::new();
    for top in (BORDER..height - BORDER).step_by(CELL) {
        let rows = top..(top + CELL).min(height - BORDER);
        for left in (BORDER..width - BORDER).step_by(CELL) {
            let columns = left..(left + CELL).min(width - BORDER);
            let threshold = threshold(image, columns.clone(), rows.clone());
            for v in rows.clone() {
                fast_in_row(image, v, columns.clone(), threshold, &mut candidates);
            }
        }
    }
    let mut scores = Image::filled(width, height, 0.0_f32);
    for (u, v) in &candidates {
        scores.set(*u, *v, smaller_eigenvalue(image, *u, *v));
    }
    let mut corners: Vec<Corner> = candidates
        .into_iter()
        .filter(|(u, v)| is_best_around(&scores, *u, *v))
        .map(|(u, v)| Corner {
            u,
            v,
            score: scores.at(u, v),
            rank: 0,
        })
        .collect();
    let cell_of = |corner: &Corner| ((corner.v - BORDER) / CELL, (corner.u - BORDER) / CELL);
    corners.sort_by(|a, b| {
        let by_score = b.score.total_cmp(&a.score);
        cell_of(a).cmp(&cell_of(b)).then(by_score)
    });
    for i in 1..corners.len() {
        if cell_of(&corners[i]) == cell_of(&corners[i - 1]) {
            corners[i].rank = corners[i - 1].rank + 1;
        }
    }
    corners
}

/// How much brighter or darker a corner must be than what is around it.
fn threshold(image: &Image<u8>, columns: Range<usize>, rows: Range<usize>) -> u8 {
    let (mut least, mut most) = (u8::MAX, 0);
    for v in rows {
        for value in &image.row(v)[columns.clone()] {
            least = least.min(*value);
            most = most.max(*value);
        }
    }
    ((f64::from(most - least) * MIN_SHARE_OF_CONTRAST) as u8).max(MIN_DIFFERENCE)
}

/// Appends the pixels of a row around which 9 successive of 16 are all brighter or all darker.
fn fast_in_row(
    image: &Image<u8>,
    v: usize,
    columns: Range<usize>,
    threshold: u8,
    found: &mut Vec<(usize, usize)>,
) {
    let len = columns.len();
    let shifted = |du: isize, dv: isize| {
        let row = image.row(v.wrapping_add_signed(dv));
        &row[columns.start.wrapping_add_signed(du)..][..len]
    };
    // Nine successive pixels hold one of top and bottom and one of left and right: a test that
    // runs on many pixels at once.
    let [center, top, bottom] = [shifted(0, 0), shifted(0, -3), shifted(0, 3)];
    let [left, right] = [shifted(-3, 0), shifted(3, 0)];
    let mut may_be = [0_u8; CELL];
    for i in 0..len {
        let high = center[i].saturating_add(threshold);
        let low = center[i].saturating_sub(threshold);
        let bright =
            ((top[i] > high) | (bottom[i] > high)) & ((left[i] > high) | (right[i] > high));
        let dark = ((top[i] < low) | (bottom[i] < low)) & ((left[i] < low) | (right[i] < low));
        may_be[i] = u8::from(bright | dark);
    }
    let data = image.data();
    for i in 0..len {
        if may_be[i] == 0 {
            continue;
        }
        let at = v * image.width() + columns.start + i;
        let high = center[i].saturating_add(threshold);
        let low = center[i].saturating_sub(threshold);
        let (mut bright, mut dark) = (0_u32, 0_u32);
        for (bit, (du, dv)) in CIRCLE.iter().enumerate() {
            let value = data[at.wrapping_add_signed(dv * image.width() as isize + du)];
            bright |= u32::from(value > high) << bit;
            dark |= u32::from(value < low) << bit;
        }
        if has_nine_in_a_row(bright) || has_nine_in_a_row(dark) {
            found.push((columns.start + i, v));
        }
    }
}

/// Whether nine successive of sixteen bits in a circle are set.
fn has_nine_in_a_row(circle: u32) -> bool {
    let twice = circle | circle << 16;
    let two = twice & twice >> 1;
    let four = two & two >> 2;
    let eight = four & four >> 4;
    eight & twice >> 8 != 0
}

/// The smaller eigenvalue of the structure tensor over 7x7 pixels (Shi and Tomasi 1994).
fn smaller_eigenvalue(image: &Image<u8>, u: usize, v: usize) -> f32 {
    let (mut xx, mut xy, mut yy) = (0_i32, 0_i32, 0_i32);
    for row in v - 3..=v + 3 {
        let above = &image.row(row - 1)[u - 4..][..9];
        let here = &image.row(row)[u - 4..][..9];
        let below = &image.row(row + 1)[u - 4..][..9];
        for i in 1..8 {
            let dx = i32::from(here[i + 1]) - i32::from(here[i - 1]);
            let dy = i32::from(below[i]) - i32::from(above[i]);
            xx += dx * dx;
            xy += dx * dy;
            yy += dy * dy;
        }
    }
    let [xx, xy, yy] = [xx, xy, yy].map(|sum| sum as f32);
    0.5 * (xx + yy - ((xx - yy).powi(2) + 4.0 * xy * xy).sqrt())
}

/// Whether no pixel near has a better score, nor an equal one that comes first.
fn is_best_around(scores: &Image<f32>, u: usize, v: usize) -> bool {
    let score = scores.at(u, v);
    (v - SEPARATION..=v + SEPARATION).all(|row| {
        (u - SEPARATION..=u + SEPARATION).all(|column| {
            let other = scores.at(column, row);
            other < score || (other == score && (row, column) >= (v, u))
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nine_successive_bits_of_a_circle() {
        for circle in 0..1_u32 << 16 {
            let has_run_from = |first: u32| (0..9).all(|i| circle >> ((first + i) % 16) & 1 == 1);
            assert_eq!(
                has_nine_in_a_row(circle),
                (0..16).any(has_run_from),
                "{circle:b}"
            );
        }
    }

    #[test]
    fn a_rectangle_has_four_corners() {
        let inside = |u, v| (40..70).contains(&u) && (30..55).contains(&v);
        for (dark, bright) in [(0, 255), (100, 112), (112, 100)] {
            let image = Image::from_fn(120, 90, |u, v| if inside(u, v) { bright } else { dark });
            let mut found = corners(&image);
            found.sort_by_key(|corner| (corner.v, corner.u));
            assert_eq!(found.len(), 4, "{found:?}");
            for (corner, (u, v)) in found.iter().zip([(40, 30), (69, 30), (40, 54), (69, 54)]) {
                assert!(
                    corner.u.abs_diff(u) <= 2 && corner.v.abs_diff(v) <= 2,
                    "{corner:?}"
                );
            }
        }
        let plain = Image::filled(120, 90, 77);
        assert!(corners(&plain).is_empty());
    }

    #[test]
    fn ranks_count_the_better_ones_of_the_same_cell() {
        // A point that stands out in each corner of a cell, two in the next.
        let places = [
            (20, 20, 80),
            (60, 60, 250),
            (60, 20, 160),
            (90, 20, 60),
            (100, 40, 200),
        ];
        let image = Image::from_fn(160, 96, |u, v| {
            let is_near = |(x, y, _): &&(usize, usize, u8)| u.abs_diff(*x) + v.abs_diff(*y) <= 1;
            places
                .iter()
                .find(is_near)
                .map_or(0, |(_, _, value)| *value)
        });
        let found = corners(&image);
        let expected = [
            (60, 60, 0),
            (60, 20, 1),
            (20, 20, 2),
            (100, 40, 0),
            (90, 20, 1),
        ];
        assert_eq!(found.len(), expected.len());
        for (corner, (u, v, rank)) in found.iter().zip(expected) {
            assert_eq!(corner.rank, rank, "{corner:?}");
            assert!(
                corner.u.abs_diff(u) + corner.v.abs_diff(v) <= 1,
                "{corner:?}"
            );
        }
    }
}
