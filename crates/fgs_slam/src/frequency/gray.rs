//! Grey from RGB with the weights of ITU-R BT.601 (0.299, 0.587, 0.114) in fixed point, equal to
//! OpenCV's RGB2GRAY on 8-bit images.

use fgs_geom::{Image, Kernel, dispatch};

/// The weights times 2^15. They add up to 2^15, so white stays 255.
const WEIGHTS: [u32; 3] = [9798, 19235, 3735];

/// 8-bit grey, rounded to nearest, of an image into one of the same size.
pub(super) fn gray_from_color(color: &Image<[u8; 3]>, gray: &mut Image<u8>) {
    dispatch(Weighting { color, gray });
}

/// The work, compiled for each instruction set.
struct Weighting<'a> {
    color: &'a Image<[u8; 3]>,
    gray: &'a mut Image<u8>,
}

impl Kernel for Weighting<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool, const WIDTH: usize>(self) {
        for (gray, &[r, g, b]) in self.gray.data_mut().iter_mut().zip(self.color.data()) {
            let (r, g, b) = (u32::from(r), u32::from(g), u32::from(b));
            *gray = ((WEIGHTS[0] * r + WEIGHTS[1] * g + WEIGHTS[2] * b + (1 << 14)) >> 15) as u8;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Expected values from `cv2.cvtColor(..., cv2.COLOR_RGB2GRAY)`.
    #[test]
    fn equals_opencv() {
        let expected = [
            ([255, 255, 255], 255),
            ([255, 0, 0], 76),
            ([0, 255, 0], 150),
            ([0, 0, 255], 29),
            ([1, 2, 3], 2),
            ([200, 10, 77], 74),
            ([0, 128, 1], 75),
            ([17, 230, 99], 151),
            ([254, 1, 128], 91),
            // Each of these turns over if one weight gains and another loses 2^-15.
            ([228, 205, 35], 193),
            ([99, 140, 173], 132),
            ([89, 254, 42], 180),
            ([91, 236, 33], 170),
            ([4, 75, 20], 48),
            ([64, 6, 253], 51),
        ];
        for (color, gray) in expected {
            let mut found = Image::filled(1, 1, 0);
            gray_from_color(&Image::filled(1, 1, color), &mut found);
            assert_eq!(found.at(0, 0), gray);
        }
    }
}
