//! Pixels that the camera did not see: the border that removing lens distortion leaves.
//!
//! Left black they would be an edge all around the image. Before the filter each takes the grey
//! level of the nearest seen pixel, and after it that pixel's response, so that the response's
//! range is that of the seen pixels; the threshold is found from the seen pixels alone, and the
//! others are never marked.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;

use fgs_geom::Image;

/// The unseen pixels of one mask.
pub(super) struct Unseen {
    /// True where the camera saw.
    seen: Arc<Image<bool>>,
    /// Row-major positions of each unseen pixel and of the nearest seen one.
    nearest: Vec<(usize, usize)>,
    /// Runs of seen pixels, row-major.
    seen_runs: Vec<Range<usize>>,
}

impl Unseen {
    pub fn new(seen: Arc<Image<bool>>) -> Self {
        let mut end = 0;
        let seen_runs = (seen.data().chunk_by(|a, b| a == b))
            .filter_map(|run| {
                end += run.len();
                run[0].then(|| end - run.len()..end)
            })
            .collect();
        Self {
            nearest: nearest_seen(&seen),
            seen_runs,
            seen,
        }
    }

    /// The mask.
    pub fn seen(&self) -> &Arc<Image<bool>> {
        &self.seen
    }

    /// Gives every unseen pixel of a row-major image the value of its nearest seen one.
    pub fn fill<T: Copy>(&self, pixels: &mut [T]) {
        for &(unseen, seen) in &self.nearest {
            pixels[unseen] = pixels[seen];
        }
    }

    /// The seen pixels of a row-major image, run by run.
    pub fn seen_of<'a, T>(&'a self, pixels: &'a [T]) -> impl Iterator<Item = &'a [T]> {
        self.seen_runs.iter().map(|run| &pixels[run.clone()])
    }

    /// Takes the unseen pixels out of a mask.
    pub fn clear(&self, mask: &mut [bool]) {
        for (marked, seen) in mask.iter_mut().zip(self.seen.data()) {
            *marked &= seen;
        }
    }
}

/// Each unseen pixel with the seen one that the fewest steps to left, right, up or down lead to; of
/// several the one found first, row by row. Empty if nothing was seen.
fn nearest_seen(seen: &Image<bool>) -> Vec<(usize, usize)> {
    let (width, len) = (seen.width(), seen.data().len());
    let mut source: Vec<usize> = (0..len).collect();
    let mut is_reached = seen.data().to_vec();
    let mut queue: VecDeque<usize> = (0..len).filter(|&i| is_reached[i]).collect();
    let mut nearest = Vec::new();
    while let Some(i) = queue.pop_front() {
        let (u, v) = (i % width, i / width);
        for (is_inside, step) in [
            (u > 0, i.wrapping_sub(1)),
            (u + 1 < width, i + 1),
            (v > 0, i.wrapping_sub(width)),
            (v + 1 < seen.height(), i + width),
        ] {
            if is_inside && !is_reached[step] {
                is_reached[step] = true;
                source[step] = source[i];
                nearest.push((step, source[step]));
                queue.push_back(step);
            }
        }
    }
    nearest
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring(width: usize, height: usize) -> Arc<Image<bool>> {
        Arc::new(Image::from_fn(width, height, |u, v| {
            let (du, dv) = (u.abs_diff(width / 2), v.abs_diff(height / 2));
            du + dv < 6 && (u, v) != (width / 2, height / 2)
        }))
    }

    #[test]
    fn unseen_pixels_take_the_value_of_the_nearest_seen_one() {
        let seen = ring(19, 13);
        let unseen = Unseen::new(seen.clone());
        let distance = |a: usize, b: usize| (a % 19).abs_diff(b % 19) + (a / 19).abs_diff(b / 19);
        let mut pixels: Vec<usize> = (0..19 * 13).collect();
        unseen.fill(&mut pixels);
        for (i, &source) in pixels.iter().enumerate() {
            assert!(seen.data()[source]);
            let mut all = (0..19 * 13).filter(|&j| seen.data()[j]);
            assert!(all.all(|j| distance(i, j) >= distance(i, source)), "{i}");
        }
        let kept: Vec<usize> = unseen.seen_of(&pixels).flatten().copied().collect();
        let expected = (0..19 * 13).filter(|&i| seen.data()[i]);
        assert!(kept.into_iter().eq(expected));
    }

    #[test]
    fn nothing_seen_and_no_pixels() {
        for (width, height) in [(5, 3), (0, 4), (0, 0)] {
            let unseen = Unseen::new(Arc::new(Image::filled(width, height, false)));
            let mut pixels = vec![7; width * height];
            unseen.fill(&mut pixels);
            assert_eq!(unseen.seen_of(&pixels).count(), 0);
            assert!(pixels.iter().all(|pixel| *pixel == 7));
        }
    }
}
