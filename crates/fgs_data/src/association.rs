//! One-to-one association of colour and depth images by timestamp.
//!
//! Greedy, like `associate.py` of the TUM benchmark: of all pairs within the tolerance the one with
//! the smallest time difference is taken first, then the next among the images still unpaired.

/// How many depth images on either side of a colour image's time are considered. Sensors deliver
/// the two at about the same rate, so that a partner further off is another image's.
const NEIGHBORS: usize = 4;

/// The pairs (colour, depth) of positions, in order of the colour image. Both lists of times, in
/// seconds, are strictly increasing; no position is used twice, and times in a pair differ by at
/// most `max_difference_secs`.
pub fn associate(
    color_secs: &[f64],
    depth_secs: &[f64],
    max_difference_secs: f64,
) -> Vec<(usize, usize)> {
    let mut candidates = Vec::new();
    for (color, time) in color_secs.iter().enumerate() {
        let next = depth_secs.partition_point(|depth_time| depth_time < time);
        let nearby = next.saturating_sub(NEIGHBORS)..depth_secs.len().min(next + NEIGHBORS);
        for depth in nearby {
            let difference = (depth_secs[depth] - time).abs();
            if difference <= max_difference_secs {
                candidates.push((difference, color, depth));
            }
        }
    }
    candidates.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut color_is_free = vec![true; color_secs.len()];
    let mut depth_is_free = vec![true; depth_secs.len()];
    let mut pairs = Vec::new();
    for (_, color, depth) in candidates {
        if color_is_free[color] && depth_is_free[depth] {
            color_is_free[color] = false;
            depth_is_free[depth] = false;
            pairs.push((color, depth));
        }
    }
    pairs.sort_unstable();
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_first_and_one_to_one() {
        // Colour 1 and 2 both have depth 1 nearest; 2 is nearer, so 1 falls back on depth 0.
        let pairs = associate(&[0.0, 1.0, 1.04], &[0.96, 1.03, 5.0], 0.05);
        assert_eq!(pairs, [(1, 0), (2, 1)]);
        // The first to come is not served first.
        assert_eq!(associate(&[0.0, 0.03], &[0.028], 0.04), [(1, 0)]);
        // Too far by a hair.
        assert_eq!(associate(&[0.0], &[0.0201], 0.02), []);
        assert_eq!(associate(&[], &[0.0], 0.02), []);
        assert_eq!(associate(&[0.0], &[0.0], f64::NAN), []);
    }

    #[test]
    fn equals_the_rule_applied_to_all_pairs() {
        let times = |seed: usize, n: usize, start: f64| -> Vec<f64> {
            let jitter = |i: usize| (i * seed % 17) as f64 / 1000.0;
            (0..n)
                .map(|i| start + i as f64 / 30.0 + jitter(i))
                .collect()
        };
        let (color, depth) = (times(5, 60, 0.0), times(11, 55, -0.03));
        let mut all: Vec<_> = (0..60).flat_map(|c| (0..55).map(move |d| (c, d))).collect();
        let difference = |&(c, d): &(usize, usize)| (color[c] - depth[d]).abs();
        all.sort_by(|a, b| difference(a).total_cmp(&difference(b)));
        let mut expected: Vec<(usize, usize)> = Vec::new();
        for pair in all {
            let is_free = expected
                .iter()
                .all(|used| used.0 != pair.0 && used.1 != pair.1);
            if difference(&pair) <= 0.04 && is_free {
                expected.push(pair);
            }
        }
        expected.sort_unstable();
        assert!(expected.len() >= 50);
        assert_eq!(associate(&color, &depth, 0.04), expected);
    }
}
