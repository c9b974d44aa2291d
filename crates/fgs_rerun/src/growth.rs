//! When something that grows is worth being written again.

/// Remembers how large something was when it was written last. What is written whenever it has grown by
/// a part takes a few times the room of the last of it, however long it grows.
#[derive(Default)]
pub struct Growth(usize);

impl Growth {
    /// Whether `size` is larger by an eighth, or smaller, than when this was true last.
    pub fn is_due(&mut self, size: usize) -> bool {
        let is_due = size > self.0 + self.0 / 8 || size < self.0;
        if is_due {
            self.0 = size;
        }
        is_due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_that_is_written_is_a_few_times_the_last() {
        let mut growth = Growth::default();
        let written: Vec<usize> = (0..10_000).filter(|size| growth.is_due(*size)).collect();
        assert_eq!(written[..4], [1, 2, 3, 4]);
        let last = *written.last().unwrap();
        assert!(last > 8_000, "{last}");
        assert!(written.iter().sum::<usize>() < 10 * last);
        assert!(!growth.is_due(last));
        assert!(growth.is_due(last - 1));
    }
}
