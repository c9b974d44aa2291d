//! The loss of a rendered view against the measured images.
//!
//! Input: rendered colour, depth and alpha, and the measured images. Output: the loss of Eq. (16)
//! and its derivative by every rendered value; [`scale_regularizer`] adds Eq. (15).
//! Depth is compared where it was measured; colour where the camera saw it and, if asked for, only
//! where depth was measured too. Each mean is over the pixels compared. A pixel whose colour the
//! camera did not see lies outside the image, for the windows of SSIM as well.
//!
//! Differs from the paper: its code drops every value whose target is zero (black colour channels
//! too) and divides by all pixels.

mod blur;
mod color;
mod depth;
mod l1;
mod regularizer;
mod ssim;
#[cfg(test)]
mod tests;

pub(crate) use blur::{RADIUS, TAPS, window};
pub(crate) use depth::{DEPTH_UNIT_M, MIN_ALPHA};
pub use regularizer::scale_regularizer;
pub(crate) use regularizer::{FLAT_SCALE_M, MAX_LOG_SCALE};
pub(crate) use ssim::{C1, C2};

use crate::exposure::Exposure;
use crate::{Cotangents, Rendered, SettingError};
use fgs_geom::{Image, RgbdFrame, has_depth};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use thiserror::Error;

/// Weights and options of the loss.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossSettings {
    /// Weight of the mean absolute colour error, colours in 0..1.
    pub l1_weight: f32,
    /// Weight of `1 - SSIM`.
    pub ssim_weight: f32,
    /// Weight of the mean absolute depth error in units of 10 m.
    pub depth_weight: f32,
    /// Weight of [`scale_regularizer`].
    pub scale_weight: f32,
    /// Whether colour is compared only where depth was measured too, else wherever it is valid.
    pub mask_color_by_depth: bool,
    /// Whether rendered depth, a sum of `weight * z`, is divided by rendered alpha before it is
    /// compared.
    pub normalize_depth: bool,
}

impl Default for LossSettings {
    fn default() -> Self {
        Self {
            l1_weight: 0.8,
            ssim_weight: 0.2,
            depth_weight: 0.1,
            scale_weight: 10.0,
            mask_color_by_depth: false,
            normalize_depth: true,
        }
    }
}

impl LossSettings {
    /// # Errors
    /// A weight that is negative or not finite.
    pub fn validate(&self) -> Result<(), SettingError> {
        SettingError::unless_weight("l1_weight", self.l1_weight.into())?;
        SettingError::unless_weight("ssim_weight", self.ssim_weight.into())?;
        SettingError::unless_weight("depth_weight", self.depth_weight.into())?;
        SettingError::unless_weight("scale_weight", self.scale_weight.into())
    }
}

/// The measured images of a view. Colour is kept in bytes, since there is a target per keyframe.
#[derive(Clone, Debug, PartialEq)]
pub struct Target {
    color: Image<[u8; 3]>,
    depth_m: Image<f32>,
    /// `None` if every colour is valid.
    color_valid: Option<Arc<Image<bool>>>,
    /// Number of pixels with measured depth, with valid colour, and with both.
    measured: usize,
    colored: usize,
    colored_and_measured: usize,
}

impl Target {
    /// From colour and depth (metres, 0 or non-finite where there is none), every colour valid.
    ///
    /// # Errors
    /// If the sizes differ.
    pub fn new(color: Image<[u8; 3]>, depth_m: Image<f32>) -> Result<Self, LossError> {
        check_size("depth", &depth_m, &color)?;
        let measured = depth_m.data().iter().filter(|d| has_depth(**d)).count();
        Ok(Self {
            colored: color.data().len(),
            color,
            depth_m,
            color_valid: None,
            measured,
            colored_and_measured: measured,
        })
    }

    /// Restricts the comparison to pixels with valid colour. The others become black, which to SSIM
    /// is outside the image.
    ///
    /// # Errors
    /// If the mask's size differs.
    pub fn with_color_valid(mut self, valid: Arc<Image<bool>>) -> Result<Self, LossError> {
        check_size("colour validity", &valid, &self.color)?;
        (self.colored, self.colored_and_measured) = (0, 0);
        let pixels = self.color.data_mut().iter_mut().zip(self.depth_m.data());
        for ((color, depth_m), valid) in pixels.zip(valid.data()) {
            if *valid {
                self.colored += 1;
                self.colored_and_measured += usize::from(has_depth(*depth_m));
            } else {
                *color = [0; 3];
            }
        }
        self.color_valid = Some(valid);
        Ok(self)
    }

    /// The images of a frame, and its mask of valid colours.
    ///
    /// # Errors
    /// If the sizes differ.
    pub fn from_frame(frame: &RgbdFrame) -> Result<Self, LossError> {
        let target = Self::new(frame.color.clone(), frame.depth_m.clone())?;
        match &frame.color_valid {
            Some(valid) => target.with_color_valid(valid.clone()),
            None => Ok(target),
        }
    }

    /// The same target in the exposure of a map, given what the map shows at its view.
    pub(crate) fn exposed_like(&self, rendered: &Rendered) -> Self {
        let mut color = Exposure::between(self, rendered).applied(&self.color);
        if let Some(valid) = self.color_valid() {
            for (color, valid) in color.data_mut().iter_mut().zip(valid.data()) {
                if !valid {
                    *color = [0; 3];
                }
            }
        }
        Self {
            color,
            ..self.clone()
        }
    }

    /// Measured colour, black where it is not valid.
    pub fn color(&self) -> &Image<[u8; 3]> {
        &self.color
    }

    /// Which colours are valid; `None` if all are.
    pub(crate) fn color_valid(&self) -> Option<&Image<bool>> {
        self.color_valid.as_deref()
    }

    /// How many pixels have measured depth.
    pub(crate) fn measured(&self) -> usize {
        self.measured
    }

    /// How many pixels the colour loss is over.
    pub(crate) fn compared_colors(&self, settings: &LossSettings) -> usize {
        if settings.mask_color_by_depth {
            self.colored_and_measured
        } else {
            self.colored
        }
    }

    /// Measured depth in metres, 0 or non-finite where there is none.
    pub fn depth_m(&self) -> &Image<f32> {
        &self.depth_m
    }
}

/// The loss of one view, without the regulariser.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageLoss {
    /// Weighted sum of the three parts.
    pub total: f64,
    /// Mean absolute colour error over compared pixels and channels.
    pub l1: f64,
    /// Mean SSIM over compared pixels and channels, 1 if there is none.
    pub ssim: f64,
    /// Mean absolute depth error over measured pixels, in units of 10 m.
    pub depth: f64,
}

/// Why the loss could not be computed.
#[derive(Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum LossError {
    /// Two images that belong together differ in size.
    #[error(
        "{what} is {width}x{height}, but the target's colour is {target_width}x{target_height}"
    )]
    Size {
        /// Which image.
        what: &'static str,
        /// Its columns.
        width: usize,
        /// Its rows.
        height: usize,
        /// Columns of the target's colour.
        target_width: usize,
        /// Rows of the target's colour.
        target_height: usize,
    },
    /// A rendered value is not finite, or so large that its square could not be trusted.
    #[error("rendered {what} at pixel ({u}, {v}) is {value}")]
    OutOfRange {
        /// Which image.
        what: &'static str,
        /// Column.
        u: usize,
        /// Row.
        v: usize,
        /// The value.
        value: f32,
    },
}

/// Limit of rendered values: a sane map stays far below (colours about 0..1, depths under 1e3 m),
/// and no square or product in the loss overflows.
pub(crate) const MAX_RENDERED: f32 = 1e4;

/// The loss of a render against its target, Eq. (16) without the regulariser. Overwrites
/// `cotangents` with the derivatives of its total; those by alpha are zero unless depth is
/// normalised. With no pixel to compare, loss and derivatives are zero.
///
/// # Errors
/// If an image's size is not the target's, or a rendered value is not finite or above 1e4.
pub fn photometric_loss(
    rendered: &Rendered,
    target: &Target,
    settings: &LossSettings,
    cotangents: &mut Cotangents,
) -> Result<ImageLoss, LossError> {
    let Rendered {
        color,
        depth_m,
        alpha,
    } = rendered;
    check_size("rendered colour", color, &target.color)?;
    check_size("rendered depth", depth_m, &target.color)?;
    check_size("rendered alpha", alpha, &target.color)?;
    check_range("colour", color.data().as_flattened(), color.width(), 3)?;
    check_range("depth", depth_m.data(), depth_m.width(), 1)?;
    check_range("alpha", alpha.data(), alpha.width(), 1)?;

    cotangents.resize(color.width(), color.height());
    let color_loss = color::color_loss(color, target, settings, &mut cotangents.d_color);
    let depth_loss = depth::depth_loss(
        depth_m,
        alpha,
        target,
        settings,
        &mut cotangents.d_depth_m,
        &mut cotangents.d_alpha,
    );
    Ok(ImageLoss {
        total: f64::from(settings.l1_weight) * color_loss.l1
            + f64::from(settings.ssim_weight) * color_loss.dissimilarity
            + f64::from(settings.depth_weight) * depth_loss,
        l1: color_loss.l1,
        ssim: 1.0 - color_loss.dissimilarity,
        depth: depth_loss,
    })
}

fn check_size<T>(
    what: &'static str,
    image: &Image<T>,
    color: &Image<[u8; 3]>,
) -> Result<(), LossError> {
    if (image.width(), image.height()) == (color.width(), color.height()) {
        return Ok(());
    }
    Err(LossError::Size {
        what,
        width: image.width(),
        height: image.height(),
        target_width: color.width(),
        target_height: color.height(),
    })
}

/// Values per task, for any number of threads.
const RANGE_CHUNK: usize = 64 * 1024;

fn check_range(
    what: &'static str,
    values: &[f32],
    width: usize,
    channels: usize,
) -> Result<(), LossError> {
    let sane = |value: &f32| value.abs() <= MAX_RENDERED;
    // Counted, not searched: without a branch per value it vectorises.
    let count_insane = |chunk: &[f32]| chunk.iter().map(|x| u32::from(!sane(x))).sum::<u32>();
    if values
        .par_chunks(RANGE_CHUNK)
        .all(|chunk| count_insane(chunk) == 0)
    {
        return Ok(());
    }
    match values.iter().position(|value| !sane(value)) {
        None => Ok(()),
        Some(at) => Err(LossError::OutOfRange {
            what,
            u: at / channels % width,
            v: at / channels / width,
            value: values[at],
        }),
    }
}
