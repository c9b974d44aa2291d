//! Peak signal-to-noise ratio of a rendered image, in three variants (Sec. IV), and its SSIM.
//!
//! The render's floats are clamped to 0..=1 and not quantised; the target's bytes are divided by
//! 255. The squared error is averaged over pixels and colour channels. "All pixels" are those whose
//! colour the camera saw: the border that removing lens distortion leaves is no part of the image.

use fgs_geom::{Image, has_depth};
use rayon::prelude::*;

use crate::pixels::{check_size, unit_from_byte, unit_from_float};
use crate::{EvalError, ssim};

/// No PSNR is reported higher, not even that of identical images, which would be infinite: JSON has
/// no infinity, and 8-bit rounding alone limits real images to 59 dB.
pub const MAX_PSNR_DB: f64 = 100.0;

/// How closely a rendered image matches the camera's, without LPIPS.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageQuality {
    /// PSNR over the valid pixels with measured depth, dB; `None` if there are none.
    pub psnr_valid_depth_db: Option<f64>,
    /// PSNR over all valid pixels, dB.
    pub psnr_db: f64,
    /// PSNR as the paper's code computes it, dB: over all valid pixels, both images black where no
    /// depth is measured, so that those pixels count as correct.
    pub psnr_paper_db: f64,
    /// Structural similarity over all windows of valid pixels, at most 1; see [`ssim`].
    pub ssim: f64,
}

impl ImageQuality {
    /// The mean over frames, that of `psnr_valid_depth_db` over the frames that have it.
    /// `None` without frames.
    pub fn mean(frames: &[Self]) -> Option<Self> {
        let mean = |value: &dyn Fn(&Self) -> Option<f64>| {
            let values: Vec<f64> = frames.iter().filter_map(value).collect();
            (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
        };
        Some(Self {
            psnr_valid_depth_db: mean(&|frame| frame.psnr_valid_depth_db),
            psnr_db: mean(&|frame| Some(frame.psnr_db))?,
            psnr_paper_db: mean(&|frame| Some(frame.psnr_paper_db))?,
            ssim: mean(&|frame| Some(frame.ssim))?,
        })
    }
}

/// Compares a render (RGB, nominally 0..=1) with the camera's image, where `color_valid` is true
/// (`None`: everywhere); `depth_m` is the measured depth.
///
/// # Errors
/// For images of unequal size or smaller than SSIM's window, if no such window is wholly valid, and
/// if a rendered value is NaN.
pub fn image_quality(
    render: &Image<[f32; 3]>,
    target: &Image<[u8; 3]>,
    depth_m: &Image<f32>,
    color_valid: Option<&Image<bool>>,
) -> Result<ImageQuality, EvalError> {
    check_size(render, depth_m)?;
    let ssim = ssim(render, target, color_valid)?; // checks the rest
    let rows: Vec<SquaredErrors> = (0..render.height())
        .into_par_iter()
        .map(|v| {
            let color_valid = color_valid.map(|valid| valid.row(v));
            SquaredErrors::of_row(render.row(v), target.row(v), depth_m.row(v), color_valid)
        })
        .collect();
    let total = rows
        .iter()
        .fold(SquaredErrors::default(), |sum, row| SquaredErrors {
            all: sum.all + row.all,
            pixels: sum.pixels + row.pixels,
            with_depth: sum.with_depth + row.with_depth,
            pixels_with_depth: sum.pixels_with_depth + row.pixels_with_depth,
        });
    Ok(ImageQuality {
        psnr_valid_depth_db: (total.pixels_with_depth > 0)
            .then(|| psnr_db(total.with_depth, total.pixels_with_depth)),
        psnr_db: psnr_db(total.all, total.pixels),
        psnr_paper_db: psnr_db(total.with_depth, total.pixels),
        ssim,
    })
}

/// Sums over RGB and valid pixels, and how many pixels those are.
#[derive(Default)]
struct SquaredErrors {
    all: f64,
    pixels: usize,
    with_depth: f64,
    pixels_with_depth: usize,
}

impl SquaredErrors {
    fn of_row(
        render: &[[f32; 3]],
        target: &[[u8; 3]],
        depth_m: &[f32],
        color_valid: Option<&[bool]>,
    ) -> Self {
        let mut sum = Self::default();
        let pixels = render.iter().zip(target).zip(depth_m).enumerate();
        for (u, ((render, target), &depth_m)) in pixels {
            if color_valid.is_some_and(|valid| !valid[u]) {
                continue;
            }
            let error: f64 = (render.iter().zip(target))
                .map(|(&r, &t)| (unit_from_float(r) - unit_from_byte(t)).powi(2))
                .sum();
            sum.all += error;
            sum.pixels += 1;
            if has_depth(depth_m) {
                sum.with_depth += error;
                sum.pixels_with_depth += 1;
            }
        }
        sum
    }
}

/// PSNR for values in 0..=1 from a sum of squares over RGB.
fn psnr_db(squared_error: f64, pixels: usize) -> f64 {
    let mean = squared_error / (3 * pixels) as f64;
    (-10.0 * mean.log10()).min(MAX_PSNR_DB)
}
