//! Things side by side, as wide registers hold them: a loop over lanes that neither branches nor
//! calls is compiled to work on all of them at once. A kernel's `WIDTH` tells how many things that
//! should be: blocks of 16 pixels are worked on in one part or in two.

/// Pixels of a block.
pub(super) const LANES: usize = 16;

/// A number of each pixel of a block.
pub(super) type Lanes<T> = [T; LANES];

/// The numbers of a block's pixels from `first` on.
#[inline(always)]
pub(super) fn part<T: Copy, const WIDTH: usize>(lanes: &Lanes<T>, first: usize) -> [T; WIDTH] {
    std::array::from_fn(|lane| lanes[first + lane])
}

/// Puts the numbers of a block's pixels from `first` on in their places.
#[inline(always)]
pub(super) fn set_part<T: Copy, const WIDTH: usize>(
    lanes: &mut Lanes<T>,
    first: usize,
    values: [T; WIDTH],
) {
    for (lane, value) in values.into_iter().enumerate() {
        lanes[first + lane] = value;
    }
}

/// All numbers of one thing.
#[inline(always)]
pub(super) fn column<T: Copy, const WIDTH: usize, const N: usize>(
    lanes: &[[T; WIDTH]; N],
    lane: usize,
) -> [T; N] {
    std::array::from_fn(|i| lanes[i][lane])
}

/// Puts all numbers of one thing in their places.
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
