//! Every setting of the system, with the defaults for a hand-held consumer sensor.
//!
//! A TOML file may give any part of it; unknown keys are refused. Algorithms read values from here
//! and never a data set's name.

use fgs_splat::{LearningRates, LossSettings};
use serde::{Deserialize, Serialize};

/// The whole configuration. Its effective value is written beside every result and reruns it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SlamConfig {
    /// Seed of the one random choice, which keyframe to optimise next.
    pub seed: u64,
    /// Camera tracking.
    pub tracking: TrackingConfig,
    /// Which frames become keyframes.
    pub keyframes: KeyframeConfig,
    /// Where new gaussians go and how they look.
    pub seeding: SeedingConfig,
    /// Optimisation of the map.
    pub mapping: MappingConfig,
}

/// Registration of a frame with the sparse map (paper, Sec. III-B).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackingConfig {
    /// Distance between the pixels that are tracked. Left out, it follows the focal length, so that
    /// the points lie equally dense whatever the resolution: 4 at a Kinect's 525 px.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grid_stride_px: Option<usize>,
    /// Measurements further away are not tracked (they are still mapped).
    pub max_depth_m: f64,
    /// Points further apart than this do not correspond.
    pub max_correspondence_distance_m: f64,
    /// A plane that misses its window's depths by more than this share of the depth (rms) is no
    /// surface.
    pub max_fit_error: f64,
    /// A surface's variance across, relative to its variance along: larger for rougher depth.
    pub disk_thickness: f64,
    /// Variances grow with this power of depth squared: 2 for sensors that triangulate, whose
    /// error grows with the square of the distance.
    pub noise_power: f64,
    /// What gives the sparse map its covariances.
    pub target: TargetCovariance,
    /// A frame of which a smaller share corresponds to the map is lost.
    pub min_inlier_share: f64,
    /// A frame whose weakest direction is constrained less than this share of the strongest is
    /// lost.
    pub min_conditioning: f64,
}

/// Where the covariances of the tracking target come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TargetCovariance {
    /// The surface normal measured when the gaussian was seeded.
    Seeded,
    /// Recomputed from the sparse map's nearest neighbours, as the paper's code does.
    Neighbors,
}

/// Keyframe decisions and the growth of the sparse map (paper, Sec. III-C).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KeyframeConfig {
    /// A point overlaps the sparse map when a map point is nearer than this.
    pub overlap_distance_m: f64,
    /// A frame of which a smaller share overlaps becomes a tracking keyframe.
    pub min_overlap_share: f64,
    /// Every so many frames after the last tracking keyframe comes a mapping keyframe.
    pub mapping_every: usize,
    /// A tracking keyframe's points join the sparse map when no map point is nearer than this.
    pub new_point_distance_m: f64,
    /// Which of a tracking keyframe's points may join the sparse map.
    pub new_points: NewPoints,
}

/// Which points of a tracking keyframe may join the sparse map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NewPoints {
    /// Those far enough from the sparse map.
    Distance,
    /// Those far enough from it that also lie in the missing region of the dense map, as the paper
    /// says.
    Mask,
}

/// Adaptive seeding (paper, Sec. III-A).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SeedingConfig {
    /// Equalise contrast before the Fourier segmentation.
    pub clahe: bool,
    /// Distance between seeds where the image has detail (m).
    pub high_stride_px: usize,
    /// Distance between seeds elsewhere (n).
    pub low_stride_px: usize,
    /// Standard deviation of a seed in the image plane where there is detail, Eq. (11).
    pub high_sigma_px: f64,
    /// Standard deviation of a seed in the image plane elsewhere, Eq. (11).
    pub low_sigma_px: f64,
    /// The map is missing where its accumulated alpha is less than this (M_i).
    pub min_alpha: f32,
    /// Also where it lies far behind the measured depth (M_d).
    pub depth_mask: bool,
    /// How many times the median depth error is far.
    pub depth_error_factor: f32,
    /// Also where its colour is off (M_c).
    pub color_mask: bool,
    /// Sum of absolute errors over red, green and blue (each 0 to 1) that is off.
    pub max_color_error: f32,
    /// How the disks lie.
    pub disks: Disks,
}

/// The direction of a new disk's flat axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Disks {
    /// The surface normal where the depth gives one, else the viewing direction.
    Normal,
    /// The viewing direction.
    View,
}

/// Optimisation (paper, Sec. III-D).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MappingConfig {
    /// Optimisation steps per input frame, on average.
    pub iterations_per_frame: f64,
    /// How many of a new keyframe's first steps go to itself.
    pub newest_first: usize,
    /// A keyframe that shows more than this share of the current one's gaussians is covisible.
    pub min_covisible_share: f32,
    /// Share of the steps that go to covisible keyframes; the rest goes to the others.
    pub covisible_probability: f64,
    /// At most so many keyframes stay in memory for optimisation.
    pub max_keyframes: usize,
    /// Steps between prunings.
    pub prune_every: usize,
    /// Gaussians less opaque are pruned.
    pub prune_opacity: f32,
    /// Gaussians with a longer axis are pruned.
    pub prune_scale_m: f32,
    /// Gaussians with a larger ratio of the in-plane axes are pruned.
    pub prune_aspect: f32,
    /// What a rendered view is compared by.
    pub loss: LossSettings,
    /// Learning rates.
    pub learning_rates: LearningRates,
}

impl Default for SlamConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            tracking: TrackingConfig::default(),
            keyframes: KeyframeConfig::default(),
            seeding: SeedingConfig::default(),
            mapping: MappingConfig::default(),
        }
    }
}

impl Default for TrackingConfig {
    fn default() -> Self {
        Self {
            grid_stride_px: None,
            max_depth_m: 5.0,
            max_correspondence_distance_m: 0.03,
            max_fit_error: 0.01,
            disk_thickness: 1e-3,
            noise_power: 2.0,
            target: TargetCovariance::Seeded,
            min_inlier_share: 0.3,
            min_conditioning: 1e-4,
        }
    }
}

impl Default for KeyframeConfig {
    fn default() -> Self {
        Self {
            overlap_distance_m: 0.03,
            min_overlap_share: 0.8,
            mapping_every: 10,
            new_point_distance_m: 0.015,
            new_points: NewPoints::Distance,
        }
    }
}

impl Default for SeedingConfig {
    fn default() -> Self {
        Self {
            clahe: true,
            high_stride_px: 2,
            low_stride_px: 4,
            high_sigma_px: 0.8,
            low_sigma_px: 1.6,
            min_alpha: 0.98,
            depth_mask: false,
            depth_error_factor: 10.0,
            color_mask: false,
            max_color_error: 0.5,
            disks: Disks::Normal,
        }
    }
}

impl Default for MappingConfig {
    fn default() -> Self {
        Self {
            iterations_per_frame: 2.8,
            newest_first: 1,
            min_covisible_share: 0.7,
            covisible_probability: 0.3,
            max_keyframes: 200,
            prune_every: 200,
            prune_opacity: 0.005,
            prune_scale_m: 1.0,
            prune_aspect: 10.0,
            loss: LossSettings::default(),
            learning_rates: LearningRates::default(),
        }
    }
}

impl SlamConfig {
    /// Refuses values no run can work with.
    ///
    /// # Errors
    /// The offending key with what it should be.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let positive = |key, value: f64| check(key, value, value > 0.0, "more than 0");
        let share =
            |key, value: f64| check(key, value, (0.0..=1.0).contains(&value), "between 0 and 1");
        let count = |key, value: usize| check(key, value as f64, value > 0, "at least 1");
        let (tracking, keyframes) = (&self.tracking, &self.keyframes);
        let (seeding, mapping) = (&self.seeding, &self.mapping);
        if let Some(stride) = tracking.grid_stride_px {
            count("tracking.grid_stride_px", stride)?;
        }
        positive("tracking.max_depth_m", tracking.max_depth_m)?;
        positive(
            "tracking.max_correspondence_distance_m",
            tracking.max_correspondence_distance_m,
        )?;
        positive("tracking.max_fit_error", tracking.max_fit_error)?;
        positive("tracking.disk_thickness", tracking.disk_thickness)?;
        check(
            "tracking.noise_power",
            tracking.noise_power,
            (0.0..=4.0).contains(&tracking.noise_power),
            "between 0 and 4",
        )?;
        share("tracking.min_inlier_share", tracking.min_inlier_share)?;
        share("tracking.min_conditioning", tracking.min_conditioning)?;
        positive("keyframes.overlap_distance_m", keyframes.overlap_distance_m)?;
        share("keyframes.min_overlap_share", keyframes.min_overlap_share)?;
        count("keyframes.mapping_every", keyframes.mapping_every)?;
        positive(
            "keyframes.new_point_distance_m",
            keyframes.new_point_distance_m,
        )?;
        count("seeding.high_stride_px", seeding.high_stride_px)?;
        count("seeding.low_stride_px", seeding.low_stride_px)?;
        positive("seeding.high_sigma_px", seeding.high_sigma_px)?;
        positive("seeding.low_sigma_px", seeding.low_sigma_px)?;
        share("seeding.min_alpha", seeding.min_alpha.into())?;
        positive(
            "seeding.depth_error_factor",
            seeding.depth_error_factor.into(),
        )?;
        positive("seeding.max_color_error", seeding.max_color_error.into())?;
        let iterations = mapping.iterations_per_frame;
        check(
            "mapping.iterations_per_frame",
            iterations,
            (0.0..=1e4).contains(&iterations),
            "between 0 and 10000",
        )?;
        share(
            "mapping.min_covisible_share",
            mapping.min_covisible_share.into(),
        )?;
        share(
            "mapping.covisible_probability",
            mapping.covisible_probability,
        )?;
        count("mapping.max_keyframes", mapping.max_keyframes)?;
        count("mapping.prune_every", mapping.prune_every)?;
        share("mapping.prune_opacity", mapping.prune_opacity.into())?;
        positive("mapping.prune_scale_m", mapping.prune_scale_m.into())?;
        positive("mapping.prune_aspect", mapping.prune_aspect.into())?;
        let loss = &mapping.loss;
        for (key, weight) in [
            ("mapping.loss.l1_weight", loss.l1_weight),
            ("mapping.loss.ssim_weight", loss.ssim_weight),
            ("mapping.loss.depth_weight", loss.depth_weight),
            ("mapping.loss.scale_weight", loss.scale_weight),
        ] {
            check(key, weight.into(), weight >= 0.0, "0 or more")?;
        }
        let rates = &mapping.learning_rates;
        for (key, rate) in [
            ("mapping.learning_rates.means", rates.means),
            ("mapping.learning_rates.quats", rates.quats),
            ("mapping.learning_rates.log_scales", rates.log_scales),
            (
                "mapping.learning_rates.opacity_logits",
                rates.opacity_logits,
            ),
            ("mapping.learning_rates.sh", rates.sh),
        ] {
            check(
                key,
                rate.into(),
                (0.0..=1.0).contains(&rate),
                "between 0 and 1",
            )?;
        }
        Ok(())
    }
}

/// A setting that no run can work with.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{key} = {value} is not possible: it must be {expected}")]
pub struct ConfigError {
    /// Dotted path of the setting.
    pub key: &'static str,
    /// The value refused.
    pub value: f64,
    /// What it should be.
    pub expected: &'static str,
}

fn check(
    key: &'static str,
    value: f64,
    possible: bool,
    expected: &'static str,
) -> Result<(), ConfigError> {
    if possible && value.is_finite() {
        Ok(())
    } else {
        Err(ConfigError {
            key,
            value,
            expected,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_possible() {
        assert_eq!(SlamConfig::default().validate(), Ok(()));
    }

    #[test]
    fn impossible_values_are_named() {
        let refused = |change: fn(&mut SlamConfig)| {
            let mut config = SlamConfig::default();
            change(&mut config);
            config.validate().unwrap_err().key
        };
        assert_eq!(
            refused(|c| c.tracking.grid_stride_px = Some(0)),
            "tracking.grid_stride_px"
        );
        assert_eq!(
            refused(|c| c.keyframes.min_overlap_share = f64::NAN),
            "keyframes.min_overlap_share"
        );
        assert_eq!(
            refused(|c| c.mapping.iterations_per_frame = f64::INFINITY),
            "mapping.iterations_per_frame"
        );
        assert_eq!(
            refused(|c| c.mapping.learning_rates.sh = -1.0),
            "mapping.learning_rates.sh"
        );
    }
}
