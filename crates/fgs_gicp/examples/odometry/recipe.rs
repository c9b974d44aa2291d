//! Options of the odometry, given as `key=value` arguments.

use std::collections::HashMap;
use std::path::PathBuf;
use std::str::FromStr;

use anyhow::{Context, Result, anyhow, bail};
use fgs_gicp::{DepthGrid, Kernel, Settings};

/// The variant of the odometry to run.
#[derive(Debug)]
pub struct Recipe {
    pub camera: Option<PathBuf>,
    pub frames: usize,
    pub grid: DepthGrid,
    pub settings: Settings,
    /// Use the fitted rather than the measured position.
    pub fitted: bool,
    /// `disk`, `iso` or `neighbors`.
    pub covariance: String,
    /// Variance along the normal of a disk, relative to that in the tangent plane.
    pub thickness: f64,
    /// Number of neighbours for the `neighbors` covariance.
    pub neighbors: usize,
    /// Standard deviations scale with this power of depth.
    pub noise_power: f64,
    /// Start from the pose predicted at constant velocity rather than the previous pose.
    pub constant_velocity: bool,
    /// Minimum distance of new map points from existing ones.
    pub spacing_m: f32,
    /// Add a keyframe when the inlier ratio falls below this: the fraction of points that have a
    /// map point within the correspondence distance.
    pub min_overlap: f64,
    /// Replace the map at each keyframe instead of extending it.
    pub replace: bool,
    /// Cell size of the map.
    pub cell_m: f32,
    /// Stride of the pixel grid from which map points are taken; tracking uses that of `grid`.
    pub map_stride: usize,
}

impl Recipe {
    pub fn parse(options: &[String]) -> Result<Self> {
        let mut values = HashMap::new();
        for option in options {
            let (key, value) = option
                .split_once('=')
                .with_context(|| format!("{option}: no ="))?;
            values.insert(key, value);
        }
        let camera = values.remove("camera").map(PathBuf::from);
        let mut get = |key: &str, default: f64| match values.remove(key) {
            Some(value) => f64::from_str(value).map_err(|e| anyhow!("{key}: {e}")),
            None => Ok(default),
        };
        let stride = get("stride", 5.0)? as usize;
        let grid = DepthGrid {
            stride_px: stride,
            window_radius_px: get("window", 4.0)? as usize,
            window_step_px: get("step", 2.0)? as usize,
            max_depth_m: get("max_depth", 100.0)? as f32,
            max_depth_step: get("max_step", 0.05)? as f32,
            max_fit_error: get("max_fit", 0.01)?,
            min_cosine: get("min_cos", 0.1)?,
            min_support: get("support", 0.5)?,
        };
        let scale_m = get("scale", 0.005)?;
        let recipe = Self {
            camera,
            frames: get("frames", 1e9)? as usize,
            grid,
            fitted: get("fitted", 1.0)? > 0.0,
            thickness: get("thickness", 1e-3)?,
            neighbors: get("neighbors", 20.0)? as usize,
            noise_power: get("noise", 0.0)?,
            constant_velocity: get("velocity", 1.0)? > 0.0,
            spacing_m: get("spacing", 0.005)? as f32,
            min_overlap: get("overlap", 0.8)?,
            replace: get("replace", 0.0)? > 0.0,
            cell_m: get("cell", 0.03)? as f32,
            map_stride: get("map_stride", stride as f64)? as usize,
            settings: Settings {
                max_correspondence_distance_m: get("distance", 0.03)? as f32,
                kernel: Kernel::None,
                max_iterations: get("iterations", 64.0)? as usize,
                rotation_epsilon_rad: get("rot", 2e-3)?,
                translation_epsilon_m: get("trans", 5e-4)?,
            },
            covariance: values.remove("cov").unwrap_or("disk").to_owned(),
        };
        let kernel = match values.remove("kernel").unwrap_or("none") {
            "none" => Kernel::None,
            "cauchy" => Kernel::Cauchy { scale_m },
            "gm" => Kernel::GemanMcClure { scale_m },
            "huber" => Kernel::Huber { scale_m },
            other => bail!("kernel={other}"),
        };
        if let Some(key) = values.keys().next() {
            bail!("unknown key {key}");
        }
        let settings = Settings {
            kernel,
            ..recipe.settings
        };
        Ok(Self { settings, ..recipe })
    }
}
