//! Sixteen things side by side, as the widest registers hold them: a loop over lanes that neither
//! branches nor calls is compiled to work on all of them at once.

/// Gaussians, or pixels of a block, that are worked on together.
pub(super) const LANES: usize = 16;

/// A number of each of 16 things.
pub(super) type Lanes<T> = [T; LANES];

/// All numbers of one of 16 things.
#[inline(always)]
pub(super) fn column<T: Copy, const N: usize>(lanes: &[Lanes<T>; N], lane: usize) -> [T; N] {
    std::array::from_fn(|i| lanes[i][lane])
}

/// Puts all numbers of one of 16 things in their places.
#[inline(always)]
pub(super) fn set_column<T: Copy, const N: usize>(
    lanes: &mut [Lanes<T>; N],
    lane: usize,
    values: [T; N],
) {
    for (lanes, value) in lanes.iter_mut().zip(values) {
        lanes[lane] = value;
    }
}
