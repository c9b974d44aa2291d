//! Which frames of a recording to look at: all of a short one, stretches of a long one.

use std::ops::Range;

use crate::median;

/// A stretch is one second at the usual 30 Hz.
const STRETCH: usize = 30;

/// Two frames lost in a row; a single lost frame is common and harmless.
const MIN_GAP: f64 = 2.5;

/// Whether so much more time than usual has passed since the frame before.
pub fn is_gap(interval_secs: f64, usual_secs: f64) -> bool {
    interval_secs > MIN_GAP * usual_secs
}

/// The usual time between frames, seconds; `None` for a single frame.
pub fn usual_interval(times_secs: &[f64]) -> Option<f64> {
    median(
        times_secs
            .windows(2)
            .map(|pair| pair[1] - pair[0])
            .collect(),
    )
}

/// Frames to look at, given the time stamps of all: at most so many, in stretches that are evenly spread
/// and in order, each without a gap.
pub fn stretches(times_secs: &[f64], max_frames: usize) -> Vec<Range<usize>> {
    let usual_secs = usual_interval(times_secs).unwrap_or(f64::INFINITY);
    let len = times_secs.len();
    let spread: Vec<Range<usize>> = if len <= max_frames {
        std::iter::once(0..len).collect()
    } else {
        let count = (max_frames / STRETCH).max(2);
        let stretch = |i: usize| {
            let start = i * (len - STRETCH) / (count - 1);
            start..start + STRETCH
        };
        (0..count).map(stretch).collect()
    };
    let follows = |i: usize| !is_gap(times_secs[i] - times_secs[i - 1], usual_secs);
    let mut without_gaps = Vec::new();
    for stretch in spread {
        let mut start = stretch.start;
        for i in stretch.clone().skip(1).filter(|i| !follows(*i)) {
            without_gaps.push(start..i);
            start = i;
        }
        without_gaps.push(start..stretch.end);
    }
    without_gaps
}

/// How many frames stretches hold.
pub fn frames_in(stretches: &[Range<usize>]) -> usize {
    stretches.iter().map(ExactSizeIterator::len).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(len: usize) -> Vec<f64> {
        (0..len).map(|i| i as f64 / 30.0).collect()
    }

    #[test]
    fn stretches_reach_from_end_to_end_without_overlap() {
        let whole = stretches(&times(500), 600);
        assert_eq!(whole.len(), 1);
        assert_eq!(whole[0], 0..500);
        for len in [601, 5000] {
            let stretches = stretches(&times(len), 600);
            assert_eq!(stretches.len(), 20);
            assert_eq!((stretches[0].start, stretches[19].end), (0, len));
            assert!(
                stretches
                    .windows(2)
                    .all(|pair| pair[0].end <= pair[1].start),
                "{len}"
            );
        }
    }

    #[test]
    fn no_stretch_has_a_gap() {
        let mut times = times(60);
        times[20..].iter_mut().for_each(|time| *time += 1.0);
        times[59] += 1.0;
        assert_eq!(stretches(&times, 600), [0..20, 20..59, 59..60]);
    }
}
