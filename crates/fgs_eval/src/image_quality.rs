//! Peak signal-to-noise ratios of a rendered image, by three names (Sec. IV), and its SSIM.
//!
//! The render's floats are clamped to 0..=1 and not quantised; the target's bytes are divided by
//! 255. The squared error is averaged over pixels and colour channels.

use fgs_geom::{Image, has_depth};
use rayon::prelude::*;

use crate::{EvalError, ssim};

/// No PSNR is reported higher, not even that of identical images, which would be infinite: JSON has
/// no infinity, and 8-bit rounding alone limits real images to 59 dB.
pub const MAX_PSNR_DB: f64 = 100.0;

/// How much a rendered image looks like the camera's, without LPIPS.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageQuality {
    /// PSNR over the pixels with measured depth, dB; `None` if there are none.
    pub psnr_valid_depth_db: Option<f64>,
    /// PSNR over all pixels, dB.
    pub psnr_db: f64,
    /// PSNR as the paper's code has it, dB: both images are black where no depth is measured, and
    /// those pixels count as correct.
    pub psnr_paper_db: f64,
    /// Structural similarity over all pixels, at most 1; see [`ssim`].
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

/// Compares a render (RGB, nominally 0..=1) with the camera's image; `depth_m` is the measured
/// depth.
///
/// # Errors
/// For images of unequal size, smaller than SSIM's window, or with a rendered NaN.
pub fn image_quality(
    render: &Image<[f32; 3]>,
    target: &Image<[u8; 3]>,
    depth_m: &Image<f32>,
) -> Result<ImageQuality, EvalError> {
    check_size(render, depth_m)?;
    let ssim = ssim(render, target)?; // checks the rest
    let rows: Vec<SquaredErrors> = (0..render.height())
        .into_par_iter()
        .map(|v| SquaredErrors::of_row(render.row(v), target.row(v), depth_m.row(v)))
        .collect();
    let total = rows
        .iter()
        .fold(SquaredErrors::default(), |sum, row| SquaredErrors {
            all: sum.all + row.all,
            valid: sum.valid + row.valid,
            valid_pixels: sum.valid_pixels + row.valid_pixels,
        });
    let pixels = render.data().len();
    Ok(ImageQuality {
        psnr_valid_depth_db: (total.valid_pixels > 0)
            .then(|| psnr_db(total.valid, total.valid_pixels)),
        psnr_db: psnr_db(total.all, pixels),
        psnr_paper_db: psnr_db(total.valid, pixels),
        ssim,
    })
}

/// Sums over RGB and pixels.
#[derive(Default)]
struct SquaredErrors {
    all: f64,
    valid: f64,
    valid_pixels: usize,
}

impl SquaredErrors {
    fn of_row(render: &[[f32; 3]], target: &[[u8; 3]], depth_m: &[f32]) -> Self {
        let mut sum = Self::default();
        for ((render, target), &depth_m) in render.iter().zip(target).zip(depth_m) {
            let error: f64 = (render.iter().zip(target))
                .map(|(&r, &t)| (unit_from_float(r) - unit_from_byte(t)).powi(2))
                .sum();
            sum.all += error;
            if has_depth(depth_m) {
                sum.valid += error;
                sum.valid_pixels += 1;
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

/// A rendered value as it would be shown, before rounding to a byte.
pub(crate) fn unit_from_float(value: f32) -> f64 {
    f64::from(value).clamp(0.0, 1.0)
}

/// A camera's byte on the scale of the render.
pub(crate) fn unit_from_byte(value: u8) -> f64 {
    f64::from(value) / 255.0
}

pub(crate) fn check_size<A, B>(a: &Image<A>, b: &Image<B>) -> Result<(), EvalError> {
    let (a, b) = ((a.width(), a.height()), (b.width(), b.height()));
    if a == b {
        Ok(())
    } else {
        Err(EvalError::UnequalSizes { a, b })
    }
}
