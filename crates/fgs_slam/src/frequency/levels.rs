//! The response in 256 levels, as OpenCV's threshold takes it, and the mask of the high ones.

use fgs_geom::{Kernel, dispatch};

use super::byte_from_float;

/// Values that are compared side by side: several registers, so that none waits for another.
const LANES: usize = 64;

/// A response that varies less than this many grey levels is rounding, not structure: one pixel one
/// level off stands out by almost 1, and single precision is good to about 1e-3.
const MIN_RESPONSE_RANGE: f32 = 0.01;

/// The absolute response (grey levels) scaled to 0..=255; all zero if it is constant.
pub(super) fn scale_response(response: &[f32], levels: &mut [u8]) {
    dispatch(Scaling { response, levels });
}

/// Marks the levels above a threshold.
pub(super) fn mark_above(threshold: i32, levels: &[u8], mask: &mut [bool]) {
    dispatch(Marking {
        threshold,
        levels,
        mask,
    });
}

/// Compiled for each instruction set, as is [`Marking`].
struct Scaling<'a> {
    response: &'a [f32],
    levels: &'a mut [u8],
}

impl Kernel for Scaling<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool, const WIDTH: usize>(self) {
        let Self { response, levels } = self;
        // Lanes, so that there is no order to keep.
        let (mut min, mut max) = ([f32::INFINITY; LANES], [0.0; LANES]);
        let (chunks, rest) = response.as_chunks::<LANES>();
        for chunk in chunks {
            for lane in 0..LANES {
                let value = chunk[lane].abs();
                min[lane] = if value < min[lane] { value } else { min[lane] };
                max[lane] = if value > max[lane] { value } else { max[lane] };
            }
        }
        let values = rest.iter().map(|value| value.abs());
        let min = values.clone().chain(min).fold(f32::INFINITY, f32::min);
        let max = values.chain(max).fold(0.0, f32::max);
        if max - min < MIN_RESPONSE_RANGE {
            levels.fill(0);
            return;
        }
        let scale = 255.0 / (max - min);
        for (level, value) in levels.iter_mut().zip(response) {
            *level = byte_from_float((value.abs() - min) * scale);
        }
    }
}

struct Marking<'a> {
    threshold: i32,
    levels: &'a [u8],
    mask: &'a mut [bool],
}

impl Kernel for Marking<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool, const WIDTH: usize>(self) {
        for (high, &level) in self.mask.iter_mut().zip(self.levels) {
            *high = i32::from(level) > self.threshold;
        }
    }
}
