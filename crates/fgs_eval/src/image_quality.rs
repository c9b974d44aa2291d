//! Peak signal-to-noise ratio of a rendered image, in three variants (Sec. IV), and its SSIM.
//!
//! The render's floats are clamped to 0..=1 and not quantised; the target's bytes are divided by
//! 255. The squared error is averaged over pixels and colour channels. "All pixels" are those whose
//! colour the camera saw: the border that removing lens distortion leaves is no part of the image.
//!
//! The PSNRs with exposure compare after the gain and offset of each colour channel that fit the
//! whole frame best, since cameras change both from frame to frame.

use fgs_geom::{Image, has_depth};
use rayon::prelude::*;

use crate::exposure::ChannelMoments;
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
    /// `psnr_valid_depth_db` with exposure.
    pub psnr_exposure_valid_depth_db: Option<f64>,
    /// `psnr_db` with exposure.
    pub psnr_exposure_db: f64,
    /// Structural similarity over all windows of valid pixels, at most 1; see [`ssim`].
    pub ssim: f64,
}

impl ImageQuality {
    /// The mean over frames, those over pixels with depth over the frames that have some.
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
            psnr_exposure_valid_depth_db: mean(&|frame| frame.psnr_exposure_valid_depth_db),
            psnr_exposure_db: mean(&|frame| Some(frame.psnr_exposure_db))?,
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
    let rows: Vec<Errors> = (0..render.height())
        .into_par_iter()
        .map(|v| {
            let color_valid = color_valid.map(|valid| valid.row(v));
            Errors::of_row(render.row(v), target.row(v), depth_m.row(v), color_valid)
        })
        .collect();
    let total = rows.iter().fold(Errors::default(), |sum, row| Errors {
        all: sum.all.merged(&row.all),
        with_depth: sum.with_depth.merged(&row.with_depth),
    });
    let exposures = total.all.channels.map(|channel| channel.exposure());
    let with_exposure = |errors: &PixelErrors| {
        let channels = errors.channels.iter().zip(&exposures);
        let squared = channels.map(|(channel, exposure)| channel.squared_error(exposure));
        psnr_db(squared.sum(), errors.pixels)
    };
    let has_depth = total.with_depth.pixels > 0;
    Ok(ImageQuality {
        psnr_valid_depth_db: has_depth
            .then(|| psnr_db(total.with_depth.squared, total.with_depth.pixels)),
        psnr_db: psnr_db(total.all.squared, total.all.pixels),
        psnr_paper_db: psnr_db(total.with_depth.squared, total.all.pixels),
        psnr_exposure_valid_depth_db: has_depth.then(|| with_exposure(&total.with_depth)),
        psnr_exposure_db: with_exposure(&total.all),
        ssim,
    })
}

/// Errors over RGB of some pixels.
#[derive(Default)]
struct PixelErrors {
    squared: f64,
    pixels: usize,
    channels: [ChannelMoments; 3],
}

impl PixelErrors {
    fn add(&mut self, render: &[f32; 3], target: &[u8; 3]) {
        self.pixels += 1;
        for (channel, (&r, &t)) in self.channels.iter_mut().zip(render.iter().zip(target)) {
            let (r, t) = (unit_from_float(r), unit_from_byte(t));
            self.squared += (r - t).powi(2);
            channel.add(r, t);
        }
    }

    fn merged(&self, other: &Self) -> Self {
        Self {
            squared: self.squared + other.squared,
            pixels: self.pixels + other.pixels,
            channels: std::array::from_fn(|c| self.channels[c].merged(&other.channels[c])),
        }
    }
}

/// Errors over all valid pixels, and over those with measured depth.
#[derive(Default)]
struct Errors {
    all: PixelErrors,
    with_depth: PixelErrors,
}

impl Errors {
    fn of_row(
        render: &[[f32; 3]],
        target: &[[u8; 3]],
        depth_m: &[f32],
        color_valid: Option<&[bool]>,
    ) -> Self {
        let mut errors = Self::default();
        let pixels = render.iter().zip(target).zip(depth_m).enumerate();
        for (u, ((render, target), &depth_m)) in pixels {
            if color_valid.is_some_and(|valid| !valid[u]) {
                continue;
            }
            errors.all.add(render, target);
            if has_depth(depth_m) {
                errors.with_depth.add(render, target);
            }
        }
        errors
    }
}

fn psnr_db(squared_error: f64, pixels: usize) -> f64 {
    let mean = squared_error / (3 * pixels) as f64;
    (-10.0 * mean.log10()).min(MAX_PSNR_DB)
}
