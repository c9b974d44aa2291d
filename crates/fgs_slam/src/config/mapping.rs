//! Settings of the map: where gaussians are seeded and how they are optimised (paper, Sec. III-A
//! and III-D).

use std::ops::RangeInclusive;

use fgs_splat::{LearningRates, LossSettings, SettingError};
use serde::{Deserialize, Serialize};

use crate::machine_memory::machine_memory;

/// By default, where there is memory for them: those of a large apartment.
const MOST_GAUSSIANS: usize = 4_000_000;

/// Adaptive seeding (paper, Sec. III-A).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SeedingConfig {
    /// Spacing of seeds where the image has detail (m in the paper).
    pub high_stride_px: usize,
    /// Spacing of seeds elsewhere (n in the paper).
    pub low_stride_px: usize,
    /// Standard deviation of a seed in the image plane where there is detail, Eq. (11).
    pub high_sigma_px: f64,
    /// Standard deviation of a seed in the image plane elsewhere, Eq. (11).
    pub low_sigma_px: f64,
    /// The map lacks gaussians where its accumulated alpha is less than this (M_i).
    pub min_alpha: f32,
    /// Also where it lies far behind the measured depth (M_d).
    pub depth_mask: bool,
    /// Also where its colour is far from the image's (M_c).
    pub color_mask: bool,
    /// Whether gaussians are also seeded where no depth was measured, at a depth inferred from
    /// around the hole.
    pub fill_holes: bool,
}

/// Optimisation (paper, Sec. III-D).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MappingConfig {
    /// Optimisation steps per input frame, on average.
    pub iterations_per_frame: f64,
    /// Share of the steps that go to keyframes covisible with the newest; the rest goes to the
    /// others.
    pub covisible_probability: f64,
    /// At most so many keyframes stay in memory for optimisation; fewer where images are so large that
    /// they would take more than 2 GB (97 of 1920x1080, 5 of 12 megapixels) or a quarter of the machine's memory.
    pub max_keyframes: usize,
    /// At most so many gaussians stay in the map (by default 4 million, and no more than one for each
    /// kilobyte of the machine's memory); where more are needed, those go that the newest
    /// keyframes do not show and the fewest others do. Each takes about 200 bytes of memory, on a
    /// graphics device 400 to 600. Where the camera stays in a place that needs more, poses drift: what
    /// it comes back to is gone (two centimetres in four rounds of a room with 60 % of what it needs, ten
    /// with 20 %).
    pub max_gaussians: usize,
    /// Steps between prunings.
    pub prune_every: usize,
    /// What a rendered view is compared by.
    pub loss: LossSettings,
    /// Learning rates.
    pub learning_rates: LearningRates,
}

impl Default for SeedingConfig {
    fn default() -> Self {
        Self {
            high_stride_px: 2,
            low_stride_px: 4,
            high_sigma_px: 0.8,
            low_sigma_px: 1.6,
            min_alpha: 0.98,
            depth_mask: false,
            color_mask: false,
            fill_holes: true,
        }
    }
}

impl Default for MappingConfig {
    fn default() -> Self {
        Self {
            iterations_per_frame: 2.8,
            covisible_probability: 0.3,
            max_keyframes: 200,
            max_gaussians: affordable_gaussians(machine_memory()),
            prune_every: 200,
            loss: LossSettings::default(),
            learning_rates: LearningRates::default(),
        }
    }
}

/// A quarter of the memory of small machines.
fn affordable_gaussians(memory_bytes: u64) -> usize {
    usize::try_from(memory_bytes >> 10).map_or(MOST_GAUSSIANS, |most| most.min(MOST_GAUSSIANS))
}

/// Below, a seed is never seen; above, it is larger than any image.
const SIGMAS_PX: RangeInclusive<f64> = 1e-3..=1e4;

/// Eleven days at a thousand steps a second.
const MAX_STEPS: usize = 1_000_000_000;

/// A spacing of pixels: no image is wider.
pub(super) fn unless_stride(key: &str, stride_px: usize) -> Result<(), SettingError> {
    SettingError::unless_count(key, stride_px, 65_536, "no image is wider")
}

impl SeedingConfig {
    pub(super) fn validate(&self) -> Result<(), SettingError> {
        unless_stride("high_stride_px", self.high_stride_px)?;
        unless_stride("low_stride_px", self.low_stride_px)?;
        SettingError::unless_within("high_sigma_px", self.high_sigma_px, SIGMAS_PX)?;
        SettingError::unless_within("low_sigma_px", self.low_sigma_px, SIGMAS_PX)?;
        SettingError::unless_share("min_alpha", self.min_alpha.into())
    }
}

impl MappingConfig {
    pub(super) fn validate(&self) -> Result<(), SettingError> {
        SettingError::unless_within("iterations_per_frame", self.iterations_per_frame, 0.0..=1e4)?;
        SettingError::unless_share("covisible_probability", self.covisible_probability)?;
        let reason = "each keeps its images in memory";
        SettingError::unless_count("max_keyframes", self.max_keyframes, 10_000, reason)?;
        let reason = "so many take 20 GB of memory";
        SettingError::unless_count("max_gaussians", self.max_gaussians, 100_000_000, reason)?;
        let reason = "no run takes more steps";
        SettingError::unless_count("prune_every", self.prune_every, MAX_STEPS, reason)?;
        self.loss.validate().map_err(|e| e.within("loss"))?;
        self.learning_rates
            .validate()
            .map_err(|e| e.within("learning_rates"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_takes_a_quarter_of_a_small_machine() {
        assert_eq!(affordable_gaussians(1 << 30), 1 << 20);
        assert_eq!(affordable_gaussians(64 << 30), MOST_GAUSSIANS);
    }
}
