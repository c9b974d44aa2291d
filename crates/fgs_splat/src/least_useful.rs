//! Which gaussians a full map can do without.
//!
//! What the newest views show goes last: the camera is there, and tracking needs it. Of the rest those
//! go first that the fewest views show, then the more transparent, then the older.

/// What so many of the newest views show goes last.
const RECENT_VIEWS: usize = 16;

/// So that a full map is not searched at every keyframe, more goes than must: this share of the most
/// that is allowed.
const SPARE: usize = 16;

/// Whether a recent view shows a gaussian; the bits below count views.
const IS_RECENT: u32 = 1 << 31;

/// The gaussians that make room for `added` more, so that there are no more than `max`; none if there
/// is room. `views` gives for each view, the oldest first, the gaussians that contribute to it: i is
/// bit `i % 32` of word `i / 32`.
///
/// # Errors
/// The first of `views`.
pub(crate) fn least_useful<E>(
    opacity_logits: &[f32],
    views: impl ExactSizeIterator<Item = Result<Vec<u32>, E>>,
    added: usize,
    max: usize,
) -> Result<Vec<usize>, E> {
    let count = opacity_logits.len();
    if count.saturating_add(added) <= max {
        return Ok(Vec::new());
    }
    let kept = max.saturating_sub(added).saturating_sub(max / SPARE);
    let mut seen = vec![0_u32; count];
    let old_views = views.len().saturating_sub(RECENT_VIEWS);
    for (i, words) in views.enumerate() {
        let recent = if i < old_views { 0 } else { IS_RECENT };
        for (word, seen) in words?.iter().zip(seen.chunks_mut(32)) {
            for (bit, seen) in seen.iter_mut().enumerate() {
                if word >> bit & 1 == 1 {
                    *seen = (*seen + 1) | recent;
                }
            }
        }
    }
    let mut order: Vec<usize> = (0..count).collect();
    let removed = count - kept.min(count);
    if removed > 0 && removed < count {
        order.select_nth_unstable_by(removed, |&a, &b| {
            let by_opacity = || opacity_logits[a].total_cmp(&opacity_logits[b]);
            (seen[a].cmp(&seen[b]))
                .then_with(by_opacity)
                .then(a.cmp(&b))
        });
    }
    order.truncate(removed);
    Ok(order)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn least(logits: &[f32], views: &[u32], added: usize, max: usize) -> Vec<usize> {
        let views = views.iter().map(|word| Ok::<_, ()>(vec![*word]));
        let mut least = least_useful(logits, views, added, max).unwrap();
        least.sort_unstable();
        least
    }

    #[test]
    fn nothing_goes_while_there_is_room() {
        assert_eq!(least(&[0.0; 6], &[], 4, 10), []);
        assert_eq!(least(&[], &[], 0, 0), []);
        assert_eq!(least(&[0.0; 6], &[], 5, 10), [0]);
        // All of them make too little room.
        assert_eq!(least(&[0.0; 3], &[], 50, 10), [0, 1, 2]);
    }

    #[test]
    fn a_sixteenth_more_goes_than_must() {
        assert_eq!(least(&[0.0; 32], &[], 0, 32), []);
        assert_eq!(least(&[0.0; 32], &[], 1, 32), [0, 1, 2]);
    }

    #[test]
    fn the_seldom_seen_the_transparent_and_the_old_go_first() {
        // Old views show 0 to 4, once or twice; the recent ones 5.
        let mut views = vec![0b1_1111, 0b1_0011];
        views.extend([0b10_0000; RECENT_VIEWS]);
        let logits = [1.0, 1.0, 3.0, 2.0, -9.0, -20.0, 4.0];
        let going = [6, 3, 2, 4, 0, 1, 5];
        for count in 1..=7 {
            let mut expected = going[..count].to_vec();
            expected.sort_unstable();
            assert_eq!(least(&logits, &views, count, 7), expected);
        }
    }
}
