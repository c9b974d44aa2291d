//! Associates the entries of two lists by timestamp, for example an estimated trajectory that lacks
//! the lost frames with its reference.

/// Index pairs `(i, j)` where `b_secs[j]` is the entry nearest to `a_secs[i]` and at most
/// `max_difference_secs` away, in the order of `i`. If several `i` share a nearest `j`, the closest
/// of them gets it (on ties the first). The lists need not be sorted.
pub fn associate(a_secs: &[f64], b_secs: &[f64], max_difference_secs: f64) -> Vec<(usize, usize)> {
    let mut order: Vec<usize> = (0..b_secs.len()).collect();
    order.sort_by(|&i, &j| b_secs[i].total_cmp(&b_secs[j]));
    let mut partner_of_b: Vec<Option<(usize, f64)>> = vec![None; b_secs.len()];
    for (i, &a) in a_secs.iter().enumerate() {
        let after = order.partition_point(|&j| b_secs[j] < a);
        let neighbors = [after.checked_sub(1), Some(after)];
        let nearest = (neighbors.into_iter().flatten())
            .filter_map(|k| order.get(k).map(|&j| (j, (b_secs[j] - a).abs())))
            .filter(|&(_, difference)| difference <= max_difference_secs)
            .min_by(|x, y| x.1.total_cmp(&y.1));
        if let Some((j, difference)) = nearest
            && partner_of_b[j].is_none_or(|(_, other)| difference < other)
        {
            partner_of_b[j] = Some((i, difference));
        }
    }
    let mut pairs: Vec<(usize, usize)> = (partner_of_b.iter().enumerate())
        .filter_map(|(j, partner)| partner.map(|(i, _)| (i, j)))
        .collect();
    pairs.sort_unstable();
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_within_the_limit() {
        let pairs = associate(&[0.01, 1.02, 1.99, 5.0], &[0.0, 1.0, 2.0, 3.0], 0.025);
        assert_eq!(pairs, [(0, 0), (1, 1), (2, 2)]);
    }

    #[test]
    fn nobody_has_two_partners() {
        assert_eq!(associate(&[0.9, 1.01], &[1.0], 0.5), [(1, 0)]);
        assert_eq!(associate(&[1.01, 0.9], &[1.0], 0.5), [(0, 0)]);
    }

    #[test]
    fn order_does_not_matter_and_nan_has_no_partner() {
        let pairs = associate(&[2.0, f64::NAN, 1.0], &[3.0, 1.0, f64::NAN, 2.0], 0.1);
        assert_eq!(pairs, [(0, 3), (2, 1)]);
        assert_eq!(associate(&[1.0], &[], 1.0), []);
    }
}
