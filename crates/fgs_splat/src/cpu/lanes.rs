//! SIMD lanes as plain arrays: a loop over lanes without branches or calls is vectorised by the
//! compiler. A kernel's `WIDTH` is its number of lanes: the pixels of one block or of two.

/// Pixels of a block.
pub(super) const LANES: usize = 8;

/// The `group`-th group of `WIDTH` values.
#[inline(always)]
pub(super) fn group<T, const WIDTH: usize, const N: usize>(
    values: &[T; N],
    group: usize,
) -> &[T; WIDTH] {
    &values.as_chunks::<WIDTH>().0[group % (N / WIDTH)]
}

/// As [`group`], mutable.
#[inline(always)]
pub(super) fn group_mut<T, const WIDTH: usize, const N: usize>(
    values: &mut [T; N],
    group: usize,
) -> &mut [T; WIDTH] {
    &mut values.as_chunks_mut::<WIDTH>().0[group % (N / WIDTH)]
}

/// Whether any lane is true.
#[inline(always)]
pub(super) fn any<const WIDTH: usize>(lanes: [bool; WIDTH]) -> bool {
    lanes.iter().fold(false, |any, lane| any | lane)
}

/// Positions of the set bits, ascending.
#[inline(always)]
pub(super) fn ones(mut bits: u64) -> impl Iterator<Item = usize> + Clone {
    std::iter::from_fn(move || {
        let lowest = (bits != 0).then(|| bits.trailing_zeros() as usize % 64);
        bits &= bits.wrapping_sub(1);
        lowest
    })
}

/// All values of one lane.
#[inline(always)]
pub(super) fn column<T: Copy, const WIDTH: usize, const N: usize>(
    lanes: &[[T; WIDTH]; N],
    lane: usize,
) -> [T; N] {
    std::array::from_fn(|i| lanes[i][lane])
}

/// Sets all values of one lane.
#[inline(always)]
pub(super) fn set_column<T: Copy, const WIDTH: usize, const N: usize>(
    lanes: &mut [[T; WIDTH]; N],
    lane: usize,
    values: [T; N],
) {
    for (lanes, value) in lanes.iter_mut().zip(values) {
        lanes[lane] = value;
    }
}
