//! The triangle threshold (G. W. Zack, W. E. Rogers, S. A. Latt, "Automatic measurement of sister
//! chromatid exchange frequency", 1977), equal to OpenCV's THRESH_TRIANGLE.
//!
//! In: a histogram of 8-bit levels. Out: a level; what lies strictly above it is foreground.

/// Draws a line from the peak to the end of the longer tail and returns the level one beyond the
/// one whose bar lies furthest below the line, towards that end. -1: every level is foreground;
/// 256: none, as for an empty histogram.
pub(super) fn triangle_threshold(histogram: &[u32; 256]) -> i32 {
    let occupied = |level: &usize| histogram[*level] > 0;
    let (Some(lowest), Some(highest)) = ((0..256).find(occupied), (0..256).rev().find(occupied))
    else {
        return 256;
    };
    let mut peak = lowest;
    for level in lowest..=highest {
        if histogram[level] > histogram[peak] {
            peak = level;
        }
    }
    // Where there is room, the line ends at the empty level beyond the last occupied one.
    let (left, right) = (lowest.saturating_sub(1), (highest + 1).min(255));
    if peak - left < right - peak {
        let mirrored = std::array::from_fn(|level| histogram[255 - level]);
        255 - left_threshold(&mirrored, 255 - right, 255 - peak)
    } else {
        left_threshold(histogram, left, peak)
    }
}

/// The threshold with the tail on the left, from `end` to `peak`.
fn left_threshold(histogram: &[u32; 256], end: usize, peak: usize) -> i32 {
    let (mut furthest, mut furthest_distance) = (end, 0);
    for level in end + 1..=peak {
        // The distance from the line, but for a constant factor and an offset.
        let distance = i64::from(histogram[peak]) * level as i64
            - (peak - end) as i64 * i64::from(histogram[level]);
        if distance > furthest_distance {
            (furthest, furthest_distance) = (level, distance);
        }
    }
    furthest as i32 - 1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn threshold_of(levels: impl IntoIterator<Item = u8>) -> i32 {
        let mut histogram = [0; 256];
        for level in levels {
            histogram[usize::from(level)] += 1;
        }
        triangle_threshold(&histogram)
    }

    /// Expected values from `cv2.threshold(..., cv2.THRESH_TRIANGLE)`.
    #[test]
    fn equals_opencv() {
        assert_eq!(threshold_of([0, 0, 0, 9]), 2);
        assert_eq!(threshold_of([0, 9, 9, 9]), 7);
        assert_eq!(threshold_of([0, 255]), 2);
        assert_eq!(threshold_of([254, 254, 255, 3]), 252);
        assert_eq!(threshold_of([3, 4, 4]), 2);
        assert_eq!(threshold_of([5; 4]), 4);
        assert_eq!(threshold_of([255; 4]), 254);
        let ramp = |from, to| (from..to).collect::<Vec<u8>>();
        assert_eq!(threshold_of([vec![0; 50], ramp(0, 100)].concat()), 2);
        assert_eq!(threshold_of([vec![255; 50], ramp(0, 100)].concat()), 253);
        let tail = [vec![10; 50], ramp(10, 60), vec![60; 5]].concat();
        assert_eq!(threshold_of(tail), 12);
        // Where the line ends, at the last occupied level or beyond it, decides here.
        let counts = [28, 24, 22, 15, 14, 5, 2];
        let steep = (20..).zip(counts).flat_map(|(level, n)| vec![level; n]);
        assert_eq!(threshold_of(steep), 26);
    }

    #[test]
    fn nothing_lies_above_an_empty_histogram() {
        assert_eq!(threshold_of([]), 256);
    }
}
