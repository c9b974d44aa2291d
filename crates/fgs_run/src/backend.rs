//! Where the map is optimised, as the user names it, and the empty map there.
//!
//! Decided before a run makes its folder: where a device is asked for and there is none, nothing has
//! happened yet.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use fgs_slam::{MappingConfig, model_settings};
use fgs_splat::{CpuModel, GaussianModel, GpuDevice, GpuError, GpuModel};
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
    /// What serde says of a name that is none of these.
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

/// An empty map, where it will be optimised. As text: the device in words, and why it is not
/// another.
pub struct Model {
    /// The map.
    pub map: Box<dyn GaussianModel>,
    /// The choice that gives the same device again.
    pub backend: Backend,
    /// The device's name in `metrics.json`.
    pub name: String,
    /// What is to be known about the choice; may be empty.
    note: String,
}

impl Backend {
    /// Finds the device and makes the map on it. Compiled shaders are kept in the folder
    /// `pipeline_cache` from one run to the next, if one is given.
    ///
    /// # Errors
    /// [`RunError::NoDevice`] if a graphics device was asked for and none can be used.
    pub fn model(
        self,
        config: &MappingConfig,
        pipeline_cache: Option<&Path>,
    ) -> Result<Model, RunError> {
        match self {
            Self::Cpu => Ok(on_cpu(config, None)),
            Self::Gpu => on_gpu(config, pipeline_cache, true).map_err(RunError::NoDevice),
            Self::Auto => Ok(on_gpu(config, pipeline_cache, false)
                .unwrap_or_else(|reason| on_cpu(config, Some(reason)))),
        }
    }
}

/// On the CPU, and why on no graphics device, if one was looked for.
fn on_cpu(config: &MappingConfig, reason: Option<GpuError>) -> Model {
    Model {
        map: Box::new(CpuModel::new(model_settings(config))),
        backend: Backend::Cpu,
        name: "CPU".into(),
        note: reason.map_or(String::new(), |reason| reason.to_string()),
    }
}

fn on_gpu(
    config: &MappingConfig,
    pipeline_cache: Option<&Path>,
    accept_software: bool,
) -> Result<Model, GpuError> {
    let device = GpuDevice::find(accept_software, pipeline_cache)?;
    Ok(Model {
        backend: Backend::Gpu,
        name: device.name().into(),
        note: device.caveats().join("; "),
        map: Box::new(GpuModel::new(device, &model_settings(config))?),
    })
}

impl fmt::Display for Model {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.backend, self.note.as_str()) {
            (Backend::Cpu, "") => f.write_str("the CPU"),
            (Backend::Cpu, note) => write!(f, "the CPU: {note}"),
            (_, "") => f.write_str(&self.name),
            (_, note) => write!(f, "{}, {note}", self.name),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_choice_is_said_with_its_reason() {
        let config = MappingConfig::default();
        assert_eq!(on_cpu(&config, None).to_string(), "the CPU");
        let reason = GpuError::NoAdapter(String::new());
        assert_eq!(
            on_cpu(&config, Some(reason)).to_string(),
            "the CPU: no graphics device was found"
        );
    }

    /// Whatever this machine has: a device that is found is named, and where there is none, asking
    /// for one is a usage error.
    #[test]
    fn every_backend_gives_a_model_or_a_reason() {
        let config = MappingConfig::default();
        assert_eq!(Backend::Cpu.model(&config, None).unwrap().name, "CPU");
        assert!(Backend::Auto.model(&config, None).is_ok());
        match Backend::Gpu.model(&config, None) {
            Ok(model) => assert!(model.to_string().starts_with(&model.name)),
            Err(error) => assert!(error.is_usage(), "{error}"),
        }
    }
}
