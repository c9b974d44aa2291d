//! Validation of settings. Limits are checked where the setting's type is defined, and each layer
//! prepends its name to the key: `l1_weight`, `loss.l1_weight`, `mapping.loss.l1_weight`.

use std::ops::RangeInclusive;

use fgs_geom::Number;

/// A setting with a value that is not allowed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{key} = {} is not possible: it must be {expected}", Number(*.value))]
pub struct SettingError {
    /// Dotted path of the setting.
    pub key: String,
    /// The rejected value.
    pub value: f64,
    /// What is allowed, to follow "must be".
    pub expected: String,
}

impl SettingError {
    /// The same error for a setting inside this group.
    pub fn within(self, group: &str) -> Self {
        Self {
            key: format!("{group}.{}", self.key),
            ..self
        }
    }

    /// # Errors
    /// Unless the value is finite and more than 0.
    pub fn unless_positive(key: &str, value: f64) -> Result<(), Self> {
        Self::unless(value > 0.0 && value.is_finite(), key, value, || {
            "more than 0".into()
        })
    }

    /// # Errors
    /// Unless the value is finite and 0 or more.
    pub fn unless_weight(key: &str, value: f64) -> Result<(), Self> {
        Self::unless(value >= 0.0 && value.is_finite(), key, value, || {
            "0 or more".into()
        })
    }

    /// # Errors
    /// Unless the value lies in 0..=1.
    pub fn unless_share(key: &str, value: f64) -> Result<(), Self> {
        Self::unless_within(key, value, 0.0..=1.0)
    }

    /// # Errors
    /// Unless the count is 1 to `max`; `reason` says why not more.
    pub fn unless_count(key: &str, value: usize, max: usize, reason: &str) -> Result<(), Self> {
        Self::unless((1..=max).contains(&value), key, value as f64, || {
            format!("between 1 and {max}: {reason}")
        })
    }

    /// # Errors
    /// Unless the value lies in the range.
    pub fn unless_within(key: &str, value: f64, range: RangeInclusive<f64>) -> Result<(), Self> {
        Self::unless(range.contains(&value), key, value, || {
            format!("between {} and {}", range.start(), range.end())
        })
    }

    fn unless(
        possible: bool,
        key: &str,
        value: f64,
        expected: impl FnOnce() -> String,
    ) -> Result<(), Self> {
        if possible {
            return Ok(());
        }
        Err(Self {
            key: key.into(),
            value,
            expected: expected(),
        })
    }
}
