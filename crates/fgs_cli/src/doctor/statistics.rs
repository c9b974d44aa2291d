//! Medians, and what an image's depths are like.

use fgs_geom::{Image, has_depth};
pub use fgs_sensors::median;

/// Pixels sampled for a median: its error is then below a thousandth of the spread.
const SAMPLES: usize = 20_000;

/// The median of the valid depths, metres; `None` if there are none.
pub fn median_depth(depth_m: &Image<f32>) -> Option<f32> {
    let step = (depth_m.data().len() / SAMPLES).max(1);
    // An even step would meet the same columns in every row.
    let depths = depth_m.data().iter().step_by(step | 1);
    let valid = depths
        .copied()
        .filter(|depth| has_depth(*depth))
        .map(f64::from);
    median(valid.collect()).map(|depth| depth as f32)
}

/// The share of pixels with valid depth.
pub fn depth_share(depth_m: &Image<f32>) -> f64 {
    let valid = depth_m
        .data()
        .iter()
        .filter(|depth| has_depth(**depth))
        .count();
    valid as f64 / depth_m.data().len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_of_few_values() {
        assert_eq!(median(vec![]), None);
        assert_eq!(median(vec![3.0]), Some(3.0));
        assert_eq!(median(vec![5.0, 1.0, 3.0]), Some(3.0));
    }

    #[test]
    fn pixels_without_depth_do_not_count() {
        let depth = Image::from_fn(7, 3, |u, _| if u < 3 { 0.0 } else { u as f32 });
        assert_eq!(median_depth(&depth), Some(5.0));
        assert!((depth_share(&depth) - 4.0 / 7.0).abs() <= 1e-12);
        assert_eq!(median_depth(&Image::filled(4, 4, f32::NAN)), None);
    }
}
