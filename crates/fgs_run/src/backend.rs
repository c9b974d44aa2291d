//! Where the map is optimised, and the empty map there.
//!
//! Decided before a run makes its folder: where a device is asked for and there is none, nothing has
//! happened yet.

use std::fmt;
use std::str::FromStr;

use fgs_slam::{MappingConfig, model_settings};
use fgs_splat::{CpuModel, GpuDevice, GpuError, GpuModel};
use serde::de::IntoDeserializer;
use serde::{Deserialize, Serialize};

use crate::error::RunError;

/// Where the map is to be optimised. As text: the variant's name in lower case.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Backend {
    /// On a graphics device if there is one, else on the CPU.
    #[default]
    Auto,
    /// On the CPU.
    Cpu,
    /// On a graphics device, even one emulated in software; refused where there is none.
    Gpu,
}

impl FromStr for Backend {
    type Err = serde::de::value::Error;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Self::deserialize(text.into_deserializer())
    }
}

impl fmt::Display for Backend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
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
    },
}

impl Backend {
    /// Finds the device and makes the map on it.
    ///
    /// # Errors
    /// [`RunError::NoDevice`] if a graphics device was asked for and none can be used.
    pub fn model(self, config: &MappingConfig) -> Result<Model, RunError> {
        let on_cpu = |reason| Model::Cpu {
            model: Box::new(CpuModel::new(model_settings(config))),
            reason,
        };
        let on_gpu = |accept_software| {
            let device = GpuDevice::find(accept_software)?;
            let name = device.name().to_owned();
            let model = GpuModel::new(device, model_settings(config), config.max_views_on_gpu)?;
            Ok(Model::Gpu {
                model: Box::new(model),
                device: name,
            })
        };
        match self {
            Self::Auto => Ok(on_gpu(false).unwrap_or_else(|reason| on_cpu(Some(reason)))),
            Self::Cpu => Ok(on_cpu(None)),
            Self::Gpu => on_gpu(true).map_err(RunError::NoDevice),
        }
    }
}

impl Model {
    /// The backend that makes the same choice again.
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

/// The device in words, and why it is not another.
impl fmt::Display for Model {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cpu { reason: None, .. } => f.write_str("the CPU"),
            Self::Cpu {
                reason: Some(reason),
                ..
            } => write!(f, "the CPU: {reason}"),
            Self::Gpu { device, .. } => f.write_str(device),
        }
    }
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

    /// Whatever this machine has: a device that is found is named, and where there is none, asking
    /// for one is a usage error.
    #[test]
    fn every_backend_gives_a_model_or_a_reason() {
        let config = MappingConfig::default();
        assert_eq!(Backend::Cpu.model(&config).unwrap().name(), "CPU");
        assert!(Backend::Auto.model(&config).is_ok());
        match Backend::Gpu.model(&config) {
            Ok(model) => assert_eq!(model.name(), model.to_string()),
            Err(error) => assert!(error.is_usage(), "{error}"),
        }
    }
}
