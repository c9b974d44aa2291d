//! Choices by name.

use std::fmt::Display;
use std::str::FromStr;

use pyo3::prelude::*;

use crate::errors::SettingError;

/// The value of this name, if one is given.
pub fn parsed<T: FromStr<Err: Display>>(option: &str, name: Option<&str>) -> PyResult<Option<T>> {
    let parse = |name: &str| {
        name.parse()
            .map_err(|error| SettingError::new_err(format!("{option}: {error}")))
    };
    name.map(parse).transpose()
}
