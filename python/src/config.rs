//! Settings: defaults, then a TOML file, then keyword arguments.

use std::path::PathBuf;

use fgs_run::Settings;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList, PyTuple};
use toml::Value;

use crate::errors::{IntoPython, SettingError};

/// All settings: the defaults, then a TOML file, then keyword arguments, each overriding those before.
///
/// Groups are dictionaries: ``Config(seed=2, mapping={"iterations_per_frame": 5})``; dotted names do as well:
/// ``Config(**{"mapping.iterations_per_frame": 5})``. ``Config().to_toml()`` lists all settings.
///
/// Args:
///     file: settings file (TOML); may be partial.
///     **settings: single settings.
///
/// Raises:
///     SettingError: a setting is unknown or impossible; the message names it.
#[pyclass(frozen, eq, module = "fgs_slam")]
pub struct Config {
    /// Where the settings come from.
    pub file: Option<PathBuf>,
    pub assignments: Vec<String>,
    /// All of them.
    pub settings: Settings,
}

impl PartialEq for Config {
    fn eq(&self, other: &Self) -> bool {
        self.settings == other.settings
    }
}

#[pymethods]
impl Config {
    #[new]
    #[pyo3(signature = (file = None, /, **settings))]
    fn new(file: Option<PathBuf>, settings: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let assignments = assignments(settings)?;
        let settings = Settings::load(file.as_deref(), &assignments);
        Ok(Self {
            settings: settings.map_err(IntoPython::into_python)?,
            file,
            assignments,
        })
    }

    /// All settings as TOML, as ``Config(file)`` reads them.
    fn to_toml(&self) -> PyResult<String> {
        self.settings.to_toml().map_err(IntoPython::into_python)
    }

    fn __repr__(&self) -> String {
        let file = self
            .file
            .iter()
            .map(|path| format!("{:?}", path.display().to_string()));
        let all: Vec<String> = file.chain(self.assignments.iter().cloned()).collect();
        format!("Config({})", all.join(", "))
    }
}

/// Keyword arguments as assignments `key=value` with dotted keys.
pub fn assignments(settings: Option<&Bound<'_, PyDict>>) -> PyResult<Vec<String>> {
    let mut assignments = Vec::new();
    if let Some(settings) = settings {
        flatten("", settings, &mut assignments)?;
    }
    Ok(assignments)
}

fn flatten(group: &str, settings: &Bound<'_, PyDict>, into: &mut Vec<String>) -> PyResult<()> {
    for (key, value) in settings {
        let key = key.extract::<String>()?;
        let key = if group.is_empty() {
            key
        } else {
            format!("{group}.{key}")
        };
        match value.cast::<PyDict>() {
            Ok(group) => flatten(&key, group, into)?,
            Err(_) => into.push(format!("{key}={}", toml_value(&key, &value)?)),
        }
    }
    Ok(())
}

fn toml_value(key: &str, value: &Bound<'_, PyAny>) -> PyResult<Value> {
    if let Ok(flag) = value.extract::<bool>() {
        Ok(Value::Boolean(flag))
    } else if let Ok(number) = value.extract::<i64>() {
        Ok(Value::Integer(number))
    } else if let Ok(number) = value.extract::<f64>() {
        Ok(Value::Float(number))
    } else if let Ok(text) = value.extract::<String>() {
        Ok(Value::String(text))
    } else if value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>() {
        let values = value.try_iter()?.map(|value| toml_value(key, &value?));
        Ok(Value::Array(values.collect::<PyResult<_>>()?))
    } else {
        let kind = value.get_type().name()?;
        Err(SettingError::new_err(format!(
            "{key}: a value of type {kind} is no setting"
        )))
    }
}
