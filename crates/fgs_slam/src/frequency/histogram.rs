//! How often each level occurs in an 8-bit image.

/// Counters that take turns: equal levels, which often follow each other, then need not wait for
/// the counter that has just been raised.
const TURNS: usize = 4;

/// Counts the levels of some rows.
pub(super) fn histogram<'a>(rows: impl Iterator<Item = &'a [u8]>) -> [u32; 256] {
    let mut counters = [[0; 256]; TURNS];
    for row in rows {
        let (groups, rest) = row.as_chunks::<TURNS>();
        for group in groups {
            for (counter, &level) in counters.iter_mut().zip(group) {
                counter[usize::from(level)] += 1;
            }
        }
        for &level in rest {
            counters[0][usize::from(level)] += 1;
        }
    }
    std::array::from_fn(|level| counters.iter().map(|counter| counter[level]).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_every_pixel() {
        for width in 0..11 {
            let rows: Vec<Vec<u8>> = (0..3)
                .map(|v| (0..width).map(|u| (u * u + 90 * v) as u8).collect())
                .collect();
            let counts = histogram(rows.iter().map(Vec::as_slice));
            for level in 0..=255 {
                let expected = rows.iter().flatten().filter(|&&other| other == level);
                assert_eq!(counts[usize::from(level)] as usize, expected.count());
            }
        }
    }
}
