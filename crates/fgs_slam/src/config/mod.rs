//! Every setting of the system, with the defaults for a hand-held consumer sensor.
//!
//! A TOML file may give any part of it; unknown keys are refused. Algorithms read values from here
//! and never a data set's name. Numbers of the paper that nobody has a reason to change are
//! constants beside the code that uses them.
//!
//! The few that matter first: `mapping.iterations_per_frame` (quality against time),
//! `tracking.max_depth_m` (the sensor's range) and the group `surface` (the sensor's noise).

mod loops;
mod mapping;
mod tracking;

use fgs_splat::SettingError;
use serde::{Deserialize, Serialize};

pub use loops::LoopConfig;
pub use mapping::{MappingConfig, SeedingConfig};
pub use tracking::{KeyframeConfig, SurfaceConfig, TrackingConfig};

/// The whole configuration. Its effective value is written beside every result and reruns it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SlamConfig {
    /// Seed of the one random choice, which keyframe to optimise next.
    pub seed: u64,
    /// Camera tracking.
    pub tracking: TrackingConfig,
    /// How well the sensor measures surfaces; tracking and seeding share it.
    pub surface: SurfaceConfig,
    /// Which frames become keyframes.
    pub keyframes: KeyframeConfig,
    /// Coming back to a place.
    pub loops: LoopConfig,
    /// Where new gaussians go and how large they are.
    pub seeding: SeedingConfig,
    /// Optimisation of the map.
    pub mapping: MappingConfig,
}

impl Default for SlamConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            tracking: TrackingConfig::default(),
            surface: SurfaceConfig::default(),
            keyframes: KeyframeConfig::default(),
            loops: LoopConfig::default(),
            seeding: SeedingConfig::default(),
            mapping: MappingConfig::default(),
        }
    }
}

impl SlamConfig {
    /// Refuses values no run can work with.
    ///
    /// # Errors
    /// The offending key, as a dotted path, with what it should be.
    pub fn validate(&self) -> Result<(), SettingError> {
        let in_group = |group: &'static str| move |error: SettingError| error.within(group);
        self.tracking.validate().map_err(in_group("tracking"))?;
        self.surface.validate().map_err(in_group("surface"))?;
        self.keyframes.validate().map_err(in_group("keyframes"))?;
        self.seeding.validate().map_err(in_group("seeding"))?;
        self.mapping.validate().map_err(in_group("mapping"))
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
            refused(|c| c.surface.max_fit_error = 0.0),
            "surface.max_fit_error"
        );
        assert_eq!(
            refused(|c| c.keyframes.min_overlap_share = f64::NAN),
            "keyframes.min_overlap_share"
        );
        assert_eq!(
            refused(|c| c.seeding.high_stride_px = 0),
            "seeding.high_stride_px"
        );
        assert_eq!(
            refused(|c| c.mapping.iterations_per_frame = f64::INFINITY),
            "mapping.iterations_per_frame"
        );
        assert_eq!(
            refused(|c| c.mapping.loss.ssim_weight = -1.0),
            "mapping.loss.ssim_weight"
        );
        assert_eq!(
            refused(|c| c.mapping.learning_rates.sh = -1.0),
            "mapping.learning_rates.sh"
        );
    }
}
