//! Sets of gaussians as bitmaps: the overlap of two views is a population count.

/// Words of a page: 4096 gaussians, a part of one keyframe's seeds.
const PAGE_WORDS: usize = 64;

/// A set of gaussian indices. Empty pages take no memory, so a view's set grows with what the view
/// shows, not with the map.
#[derive(Clone, Debug, Default)]
pub(crate) struct VisibleSet {
    pages: Vec<Option<Box<[u64; PAGE_WORDS]>>>,
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
        let page = word / PAGE_WORDS;
        if page >= self.pages.len() {
            self.pages.resize(page + 1, None);
        }
        let words = self.pages[page].get_or_insert_with(|| Box::new([0; PAGE_WORDS]));
        words[word % PAGE_WORDS] |= 1 << (index % 64);
    }

    /// The set whose index i is bit `i % 32` of word `i / 32`.
    pub(crate) fn from_words(words: &[u32]) -> Self {
        let mut set = Self::default();
        for (i, word) in words.iter().enumerate() {
            for bit in (0..32).filter(|bit| word >> bit & 1 == 1) {
                set.insert(32 * i + bit);
            }
        }
        set
    }

    /// The inverse of [`from_words`](Self::from_words), for indices below `len`.
    pub(crate) fn words(&self, len: usize) -> Vec<u32> {
        let mut words = vec![0; len.div_ceil(32)];
        for i in self.iter().take_while(|i| *i < len) {
            words[i / 32] |= 1 << (i % 32);
        }
        words
    }

    /// Number of indices in the set.
    pub(crate) fn count(&self) -> usize {
        self.count_common(self)
    }

    /// Number of indices in both sets.
    pub(crate) fn count_common(&self, other: &Self) -> usize {
        let pages = self.pages.iter().zip(&other.pages);
        let common = pages.filter_map(|(a, b)| Some(a.as_ref()?.iter().zip(b.as_ref()?.iter())));
        common
            .flatten()
            .map(|(a, b)| (a & b).count_ones() as usize)
            .sum()
    }

    /// Its indices, ascending.
    pub(crate) fn iter(&self) -> impl Iterator<Item = usize> + '_ {
        let pages = self.pages.iter().enumerate();
        let words = pages.flat_map(|(page, words)| {
            let words = words.iter().flat_map(|words| words.iter().enumerate());
            words.map(move |(i, word)| (PAGE_WORDS * page + i, *word))
        });
        words.flat_map(|(i, word)| {
            let mut rest = word;
            std::iter::from_fn(move || {
                let bit = (rest != 0).then(|| rest.trailing_zeros() as usize)?;
                rest &= rest - 1;
                Some(64 * i + bit)
            })
        })
    }

    /// The set after pruning: `new_from_old[i]` is the new index of gaussian i.
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
        let a = VisibleSet::from_indices(&[0, 63, 64, 200, 4096, 90_000]);
        let b = VisibleSet::from_indices(&[63, 64, 65, 4097]);
        assert_eq!(a.count(), 6);
        assert_eq!(a.count_common(&b), 2);
        assert_eq!(b.count_common(&a), 2);
        assert_eq!(a.iter().collect::<Vec<_>>(), [0, 63, 64, 200, 4096, 90_000]);
        assert_eq!(VisibleSet::default().iter().next(), None);
    }

    #[test]
    fn words_give_the_set_back() {
        let indices = [0, 31, 32, 63, 4096, 4100];
        let words = VisibleSet::from_indices(&indices).words(4101);
        assert_eq!((words.len(), words[0]), (129, 1 | 1 << 31));
        let set = VisibleSet::from_words(&words);
        assert!(set.iter().eq(indices.map(|i| i as usize)));
    }

    #[test]
    fn follows_the_gaussians_through_pruning() {
        let a = VisibleSet::from_indices(&[1, 2, 4]);
        let kept = a.compacted(&[Some(0), None, Some(1), Some(2), Some(3)]);
        assert_eq!(kept.iter().collect::<Vec<_>>(), [1, 3]);
    }
}
