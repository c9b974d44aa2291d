//! Sets of gaussians as bits, so that the overlap of two views is a count of common bits.

/// A set of gaussian indices.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct VisibleSet {
    words: Vec<u64>,
}

impl VisibleSet {
    /// The set of the given indices.
    pub(crate) fn from_indices(indices: &[u32]) -> Self {
        let mut set = Self::default();
        for &index in indices {
            set.insert(index as usize);
        }
        set
    }

    /// Adds an index.
    pub(crate) fn insert(&mut self, index: usize) {
        let word = index / 64;
        if word >= self.words.len() {
            self.words.resize(word + 1, 0);
        }
        self.words[word] |= 1 << (index % 64);
    }

    /// How many indices it holds.
    pub(crate) fn count(&self) -> usize {
        self.words.iter().map(|w| w.count_ones() as usize).sum()
    }

    /// How many indices both sets hold.
    pub(crate) fn count_common(&self, other: &Self) -> usize {
        let pairs = self.words.iter().zip(&other.words);
        pairs.map(|(a, b)| (a & b).count_ones() as usize).sum()
    }

    /// Its indices, ascending.
    pub(crate) fn iter(&self) -> impl Iterator<Item = usize> + '_ {
        self.words.iter().enumerate().flat_map(|(i, &word)| {
            let mut rest = word;
            std::iter::from_fn(move || {
                let bit = (rest != 0).then(|| rest.trailing_zeros() as usize)?;
                rest &= rest - 1;
                Some(64 * i + bit)
            })
        })
    }

    /// The set after gaussians were removed: `new_from_old[i]` is where gaussian i is now.
    pub(crate) fn compacted(&self, new_from_old: &[Option<u32>]) -> Self {
        let mut set = Self::default();
        for old in self.iter() {
            if let Some(Some(new)) = new_from_old.get(old) {
                set.insert(*new as usize);
            }
        }
        set
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_and_iterates() {
        let a = VisibleSet::from_indices(&[0, 63, 64, 200]);
        let b = VisibleSet::from_indices(&[63, 64, 65]);
        assert_eq!(a.count(), 4);
        assert_eq!(a.count_common(&b), 2);
        assert_eq!(b.count_common(&a), 2);
        assert_eq!(a.iter().collect::<Vec<_>>(), [0, 63, 64, 200]);
        assert_eq!(VisibleSet::default().iter().next(), None);
    }

    #[test]
    fn follows_the_gaussians_through_pruning() {
        let a = VisibleSet::from_indices(&[1, 2, 4]);
        let kept = a.compacted(&[Some(0), None, Some(1), Some(2), Some(3)]);
        assert_eq!(kept.iter().collect::<Vec<_>>(), [1, 3]);
    }
}
