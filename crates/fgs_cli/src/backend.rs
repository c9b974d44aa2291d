//! Where the map is optimised, as the user names it, and the empty map there.
//!
//! Decided before a run makes its folder: where a device is asked for and there is none, nothing has
//! happened yet.

use std::fmt;
use std::path::PathBuf;

use clap::ValueEnum;
use etcetera::BaseStrategy;
use fgs_slam::{MappingConfig, model_settings};
use fgs_splat::{CpuModel, GpuDevice, GpuError, GpuModel};
use serde::{Deserialize, Serialize};

use crate::failure::UsageError;

/// `--backend`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Backend {
    /// On a graphics device if there is one, else on the CPU
    #[default]
    Auto,
    /// On the CPU
    Cpu,
    /// On a graphics device, if need be one in software; refused where there is none
    Gpu,
}

/// An empty map, where it will be optimised.
pub enum Model {
    /// On the CPU.
    Cpu {
        /// The map.
        model: Box<CpuModel>,
        /// Why no graphics device is used, if one was looked for.
        reason: Option<GpuError>,
    },
    /// On a graphics device.
    Gpu {
        /// The map.
        model: Box<GpuModel>,
        /// The device's name.
        device: String,
        /// What slows it down, if anything does.
        caveats: String,
    },
}

impl Backend {
    /// Finds the device and makes the map on it.
    ///
    /// # Errors
    /// A [`UsageError`] if a graphics device was asked for and none can be used.
    pub fn model(self, config: &MappingConfig) -> Result<Model, UsageError> {
        let on_cpu = |reason| Model::Cpu {
            model: Box::new(CpuModel::new(model_settings(config))),
            reason,
        };
        let on_gpu = |accept_software| {
            let device = GpuDevice::find(accept_software, pipeline_cache().as_deref())?;
            let name = device.name().to_owned();
            let caveats = device.caveats().join("; ");
            let model = GpuModel::new(device, &model_settings(config))?;
            Ok(Model::Gpu {
                model: Box::new(model),
                device: name,
                caveats,
            })
        };
        match self {
            Self::Auto => Ok(on_gpu(false).unwrap_or_else(|reason| on_cpu(Some(reason)))),
            Self::Cpu => Ok(on_cpu(None)),
            Self::Gpu => on_gpu(true).map_err(|error: GpuError| {
                UsageError(format!("{error} (--backend cpu computes without one)"))
            }),
        }
    }
}

impl Model {
    /// What makes this choice again.
    pub fn backend(&self) -> Backend {
        match self {
            Self::Cpu { .. } => Backend::Cpu,
            Self::Gpu { .. } => Backend::Gpu,
        }
    }

    /// The device's name in `metrics.json`.
    pub fn name(&self) -> &str {
        match self {
            Self::Cpu { .. } => "CPU",
            Self::Gpu { device, .. } => device,
        }
    }
}

/// For people: the device, and why it is not another.
impl fmt::Display for Model {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cpu { reason: None, .. } => f.write_str("the CPU"),
            Self::Cpu {
                reason: Some(reason),
                ..
            } => write!(f, "the CPU: {reason}"),
            Self::Gpu {
                device, caveats, ..
            } if caveats.is_empty() => f.write_str(device),
            Self::Gpu {
                device, caveats, ..
            } => write!(f, "{device}, {caveats}"),
        }
    }
}

/// Where compiled pipelines are kept from one run to the next: in the user's cache folder.
pub fn pipeline_cache() -> Option<PathBuf> {
    let base = etcetera::choose_base_strategy().ok()?;
    Some(base.cache_dir().join("fgs-slam"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_choice_is_said_with_its_reason() {
        let on_cpu = |reason| Model::Cpu {
            model: Box::default(),
            reason,
        };
        assert_eq!(on_cpu(None).to_string(), "the CPU");
        assert_eq!(
            on_cpu(Some(GpuError::NoAdapter(String::new()))).to_string(),
            "the CPU: no graphics device was found"
        );
    }

    /// Whatever this machine has: a device that is found is named, and one that is not is explained.
    #[test]
    fn every_backend_gives_a_model_or_a_way_out() {
        let config = MappingConfig::default();
        assert_eq!(Backend::Cpu.model(&config).unwrap().name(), "CPU");
        assert!(Backend::Auto.model(&config).is_ok());
        match Backend::Gpu.model(&config) {
            Ok(model) => assert!(model.to_string().starts_with(model.name())),
            Err(error) => assert!(error.to_string().contains("--backend cpu"), "{error}"),
        }
    }
}
