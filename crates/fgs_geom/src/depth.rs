//! Depth images: what counts as a measurement, and how a sensor's integers become metres.
//!
//! Depth is the distance along the optical axis (z in camera axes), metres, in `f32`. Zero and
//! non-finite values mean "no measurement".

use crate::Image;

/// Whether a depth value is a measurement: finite and positive.
#[inline]
pub fn has_depth(depth_m: f32) -> bool {
    depth_m.is_finite() && depth_m > 0.0
}

/// Depth in metres from the integers that most sensors and file formats store: `raw / scale`, with
/// `scale` the raw value of 1 m (1000 for millimetres). Raw values of 0 and of `no_depth`, a
/// sensor's own mark for "no measurement", become 0; pass 0 if there is no such mark.
pub fn depth_from_raw(raw: &Image<u16>, scale: f32, no_depth: u16) -> Image<f32> {
    raw.map(|&value| {
        if value == no_depth {
            0.0
        } else {
            f32::from(value) / scale
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_counts_as_depth() {
        assert!(has_depth(0.5));
        for none in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert!(!has_depth(none));
        }
    }

    #[test]
    fn raw_depth_becomes_metres() {
        let raw = Image::new(4, 1, vec![0, 2500, 5000, 65535]).unwrap();
        let depth_m = depth_from_raw(&raw, 5000.0, 65535);
        assert_eq!(depth_m.data(), [0.0, 0.5, 1.0, 0.0]);
        let depth_m = depth_from_raw(&raw, 1000.0, 0);
        assert_eq!(depth_m.data(), [0.0, 2.5, 5.0, 65.535]);
    }
}
