//! The missing region: the pixels where the map does not show what the camera sees
//! (paper, Sec. III-A, Eq. 9).
//!
//! Input: a rendered view and the frame taken there. Output: M_m = M_i | M_d | M_c. Where no depth
//! was measured only M_i can tell: what is seeded there has an inferred depth, and fills holes
//! until they are measured.
//!
//! Differs from the paper: by default only M_i is used. The optimisation repairs what the other two
//! find, and the opaque seeds they would plant there cover what it has already learnt.

use fgs_geom::{Image, RgbdFrame, View, has_depth};
use fgs_splat::{GaussianModel, ModelError, Rendered};

use crate::config::SeedingConfig;

/// The map is far behind a measurement at this many times the median depth error (published code).
const DEPTH_ERROR_FACTOR: f32 = 10.0;

/// Sum of the absolute errors of red, green and blue, each 0 to 1, from which on the colour counts as
/// wrong (published code).
const MAX_COLOR_ERROR: f32 = 0.5;

/// M_m of a frame taken at `view`, of its size.
///
/// # Errors
/// If the model fails.
pub fn missing_region(
    model: &mut dyn GaussianModel,
    view: &View,
    frame: &RgbdFrame,
    config: &SeedingConfig,
) -> Result<Image<bool>, ModelError> {
    if config.depth_mask || config.color_mask {
        return Ok(all_masks(&model.render(view)?, frame, config));
    }
    // M_i alone needs one bit a pixel of the render.
    let mut missing = model.see_through(view, config.min_alpha)?;
    if !config.fill_holes {
        for (missing, depth_m) in missing.data_mut().iter_mut().zip(frame.depth_m.data()) {
            *missing &= has_depth(*depth_m);
        }
    }
    Ok(missing)
}

fn all_masks(rendered: &Rendered, frame: &RgbdFrame, config: &SeedingConfig) -> Image<bool> {
    let behind_limit_m = if config.depth_mask {
        DEPTH_ERROR_FACTOR * median_depth_error(rendered, frame)
    } else {
        f32::INFINITY
    };
    Image::from_fn(frame.depth_m.width(), frame.depth_m.height(), |u, v| {
        let measured_m = frame.depth_m.at(u, v);
        let opaque = rendered.alpha.at(u, v) >= config.min_alpha;
        if !has_depth(measured_m) {
            return config.fill_holes && !opaque;
        }
        // M_i
        !opaque
            // M_d: something new stands in front of what the map shows. Where alpha is too low to
            // tell, M_i has already answered.
            || rendered.surface_depth_m(u, v) - measured_m > behind_limit_m
            // M_c
            || (config.color_mask && color_error(rendered, frame, u, v) > MAX_COLOR_ERROR)
    })
}

fn color_error(rendered: &Rendered, frame: &RgbdFrame, u: usize, v: usize) -> f32 {
    let (shown, seen) = (rendered.color.at(u, v), frame.color.at(u, v));
    (0..3)
        .map(|i| (shown[i] - f32::from(seen[i]) / 255.0).abs())
        .sum()
}

/// The median of |rendered - measured| depth over pixels that have both; infinite without any.
fn median_depth_error(rendered: &Rendered, frame: &RgbdFrame) -> f32 {
    let mut errors: Vec<f32> = Vec::new();
    for v in 0..frame.depth_m.height() {
        for u in 0..frame.depth_m.width() {
            let measured_m = frame.depth_m.at(u, v);
            if has_depth(measured_m) && rendered.alpha.at(u, v) > 0.5 {
                errors.push((rendered.surface_depth_m(u, v) - measured_m).abs());
            }
        }
    }
    if errors.is_empty() {
        return f32::INFINITY;
    }
    let middle = errors.len() / 2;
    *errors.select_nth_unstable_by(middle, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use fgs_geom::{Camera, FrameIndex, Intrinsics};

    use super::*;

    const W: usize = 6;
    const H: usize = 4;

    /// A map that shows everything at 2 m in mid grey with 1 cm of error, and a frame that agrees.
    fn agreeing() -> (Rendered, RgbdFrame) {
        let intrinsics = Intrinsics {
            fx: 6.0,
            fy: 6.0,
            cx: 2.5,
            cy: 1.5,
        };
        let rendered = Rendered {
            color: Image::filled(W, H, [100.0 / 255.0; 3]),
            depth_m: Image::filled(W, H, 2.0 * 0.99),
            alpha: Image::filled(W, H, 0.99),
        };
        let camera = Camera::new(W, H, intrinsics).unwrap();
        let (color, depth_m) = (Image::filled(W, H, [100; 3]), Image::filled(W, H, 1.99));
        let frame = RgbdFrame::new(FrameIndex(0), 0.0, color, depth_m, camera).unwrap();
        (rendered, frame)
    }

    fn with_all_masks() -> SeedingConfig {
        SeedingConfig {
            depth_mask: true,
            color_mask: true,
            ..SeedingConfig::default()
        }
    }

    fn missing(rendered: &Rendered, frame: &RgbdFrame, config: &SeedingConfig) -> Vec<usize> {
        let mask = all_masks(rendered, frame, config);
        let hits = mask
            .data()
            .iter()
            .enumerate()
            .filter(|(_, missing)| **missing);
        hits.map(|(i, _)| i).collect()
    }

    #[test]
    fn nothing_is_missing_where_map_and_frame_agree() {
        let (rendered, frame) = agreeing();
        assert!(missing(&rendered, &frame, &with_all_masks()).is_empty());
    }

    #[test]
    fn each_mask_finds_its_own_and_can_be_switched_off() {
        let (mut rendered, mut frame) = agreeing();
        rendered.alpha.set(1, 0, 0.97);
        frame.depth_m.set(2, 1, 1.85);
        frame.color.set(3, 2, [150, 150, 140]);
        // In front by less than ten times the median error, behind by more, and a small change of
        // colour: none of them missing.
        frame.depth_m.set(4, 1, 1.92);
        frame.depth_m.set(5, 1, 2.5);
        frame.color.set(4, 2, [130, 130, 130]);
        let (opacity, depth, color) = (1, W + 2, 2 * W + 3);
        let config = with_all_masks();
        assert_eq!(missing(&rendered, &frame, &config), [opacity, depth, color]);
        let config = SeedingConfig {
            color_mask: false,
            ..config
        };
        assert_eq!(missing(&rendered, &frame, &config), [opacity, depth]);
        let config = SeedingConfig {
            depth_mask: false,
            ..config
        };
        assert_eq!(missing(&rendered, &frame, &config), [opacity]);
    }

    #[test]
    fn holes_are_missing_only_if_they_are_to_be_filled() {
        let (mut rendered, mut frame) = agreeing();
        rendered.alpha = Image::filled(W, H, 0.0);
        rendered.depth_m = Image::filled(W, H, 0.0);
        frame.depth_m.set(0, 0, 0.0);
        frame.depth_m.set(1, 0, f32::NAN);
        let mut config = with_all_masks();
        let mask = all_masks(&rendered, &frame, &config);
        assert!(mask.data().iter().all(|missing| *missing));
        config.fill_holes = false;
        let mask = all_masks(&rendered, &frame, &config);
        assert_eq!(mask.data().iter().filter(|m| **m).count(), W * H - 2);
        assert!(!mask.at(0, 0) && !mask.at(1, 0));
    }

    #[test]
    fn only_opacity_tells_whether_a_hole_is_filled() {
        let (mut rendered, mut frame) = agreeing();
        frame.depth_m.set(2, 1, 0.0);
        frame.depth_m.set(3, 1, 0.0);
        frame.color.set(2, 1, [255, 255, 255]);
        rendered.alpha.set(3, 1, 0.5);
        assert_eq!(missing(&rendered, &frame, &with_all_masks()), [W + 3]);
    }
}
