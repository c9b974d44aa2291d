//! Settings of tracking, of the surfaces that it registers, and of keyframes (paper, Sec. III-B and
//! III-C).

use fgs_splat::SettingError;
use serde::{Deserialize, Serialize};

use super::mapping::unless_stride;

/// Registration of a frame with the sparse map (paper, Sec. III-B).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackingConfig {
    /// Spacing of the pixels that are tracked. Left out, it follows the focal length, so that the
    /// points lie equally dense whatever the resolution: 4 at a Kinect's 525 px.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grid_stride_px: Option<usize>,
    /// Measurements further away are not tracked (they are still mapped).
    pub max_depth_m: f64,
    /// Points further apart than this do not correspond. Also decides whether a point overlaps the
    /// sparse map.
    pub max_correspondence_distance_m: f64,
    /// A frame with a smaller inlier ratio is lost.
    pub min_inlier_share: f64,
    /// Whether frames are aligned by their brightness too, after registration by depth.
    pub color: bool,
    /// How much of the registration's information counts beside that of colour, 0 to 1. Residuals do
    /// not show the errors that neighbouring depth pixels share: hundreds of them are worth one.
    /// 1 for exact depth.
    pub depth_trust: f64,
}

/// How well a depth image measures surfaces. Tracking and seeding share these, so that the disks of
/// the sparse map are the ones that are tracked.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SurfaceConfig {
    /// A plane fitted to a pixel's neighbourhood is no surface if its rms error exceeds this share
    /// of the depth.
    pub max_fit_error: f64,
    /// Covariance of a surface point along the normal, relative to the covariance in the tangent
    /// plane: larger for noisier depth.
    pub disk_thickness: f64,
    /// The standard deviation of depth grows with this power of the depth: 2 for structured light
    /// and stereo, 0 for depth that is equally exact everywhere.
    pub noise_power: f64,
}

/// Keyframe decisions and the growth of the sparse map (paper, Sec. III-C).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KeyframeConfig {
    /// A frame becomes a tracking keyframe if a smaller share of its points overlaps the sparse map.
    pub min_overlap_share: f64,
    /// Frames from a tracking keyframe to the first mapping keyframe after it, and from each
    /// mapping keyframe to the next.
    pub mapping_every: usize,
    /// A tracking keyframe's points join the sparse map if no map point is nearer than this.
    pub new_point_distance_m: f64,
}

impl Default for TrackingConfig {
    fn default() -> Self {
        Self {
            grid_stride_px: None,
            max_depth_m: 5.0,
            max_correspondence_distance_m: 0.03,
            min_inlier_share: 0.5,
            color: true,
            depth_trust: 0.01,
        }
    }
}

impl Default for SurfaceConfig {
    fn default() -> Self {
        Self {
            max_fit_error: 0.01,
            disk_thickness: 1e-3,
            noise_power: 2.0,
        }
    }
}

impl Default for KeyframeConfig {
    fn default() -> Self {
        Self {
            min_overlap_share: 0.8,
            mapping_every: 10,
            new_point_distance_m: 0.015,
        }
    }
}

impl TrackingConfig {
    pub(super) fn validate(&self) -> Result<(), SettingError> {
        unless_stride("grid_stride_px", self.grid_stride_px.unwrap_or(1))?;
        SettingError::unless_positive("max_depth_m", self.max_depth_m)?;
        SettingError::unless_positive(
            "max_correspondence_distance_m",
            self.max_correspondence_distance_m,
        )?;
        SettingError::unless_share("min_inlier_share", self.min_inlier_share)?;
        SettingError::unless_share("depth_trust", self.depth_trust)
    }
}

impl SurfaceConfig {
    pub(super) fn validate(&self) -> Result<(), SettingError> {
        SettingError::unless_positive("max_fit_error", self.max_fit_error)?;
        SettingError::unless_positive("disk_thickness", self.disk_thickness)?;
        SettingError::unless_within("noise_power", self.noise_power, 0.0..=4.0)
    }
}

impl KeyframeConfig {
    pub(super) fn validate(&self) -> Result<(), SettingError> {
        SettingError::unless_share("min_overlap_share", self.min_overlap_share)?;
        let reason = "no recording has more frames";
        SettingError::unless_count("mapping_every", self.mapping_every, 1_000_000_000, reason)?;
        SettingError::unless_positive("new_point_distance_m", self.new_point_distance_m)
    }
}
