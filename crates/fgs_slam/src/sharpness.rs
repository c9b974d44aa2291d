//! How sharp an image is: blur takes away differences between neighbouring pixels, and leaves those
//! between distant ones.

use fgs_geom::Image;

/// Distances of the pixels compared.
const NEAR_PX: usize = 1;
const FAR_PX: usize = 6;

/// Every so many pixels are looked at, in both directions.
const STRIDE_PX: usize = 2;

/// Squared differences of green between near pixels, relative to those between distant ones: about 1
/// for noise, far below for a smooth image. To compare images of one camera with each other.
pub fn sharpness(color: &Image<[u8; 3]>) -> f64 {
    let green = |u: usize, v: usize| f64::from(color.at(u, v)[1]);
    let (mut near, mut far) = (0.0, 0.0);
    for v in (0..color.height().saturating_sub(FAR_PX)).step_by(STRIDE_PX) {
        for u in (0..color.width().saturating_sub(FAR_PX)).step_by(STRIDE_PX) {
            let squared = |distance: usize| {
                (green(u + distance, v) - green(u, v)).powi(2)
                    + (green(u, v + distance) - green(u, v)).powi(2)
            };
            near += squared(NEAR_PX);
            far += squared(FAR_PX);
        }
    }
    if far > 0.0 { near / far } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    #[test]
    fn the_more_it_is_blurred_the_less_sharp_it_is() {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let blocks: Vec<u8> = (0..40 * 30).map(|_| rng.random()).collect();
        let sharp = Image::from_fn(160, 120, |u, v| [blocks[v / 4 * 40 + u / 4]; 3]);
        let blurred = |length: usize| {
            Image::from_fn(160, 120, |u, v| {
                let along = (0..length).map(|step| u32::from(sharp.at((u + step).min(159), v)[1]));
                [(along.sum::<u32>() / length as u32) as u8; 3]
            })
        };
        let values = [1, 3, 6].map(|length| sharpness(&blurred(length)));
        assert!(
            values[0] > 1.2 * values[1] && values[1] > 1.2 * values[2],
            "{values:?}"
        );
    }

    #[test]
    fn contrast_and_brightness_do_not_matter_and_any_image_has_a_value() {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let image = Image::from_fn(64, 48, |_, _| [rng.random_range(100..200); 3]);
        let darker = image.map(|pixel| pixel.map(|value| (value - 100) / 2));
        let ratio = sharpness(&image) / sharpness(&darker);
        assert!((ratio - 1.0).abs() <= 0.05, "{ratio}");
        for (width, height) in [(64, 48), (3, 3), (0, 0)] {
            assert_eq!(sharpness(&Image::filled(width, height, [7; 3])), 1.0);
        }
    }
}
