//! Options that choose a value of the libraries by its name, with a line of help for each name.

use std::str::FromStr;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use fgs_run::Backend;
use fgs_slam::Execution;

/// A name and its help.
type Choice = (&'static str, &'static str);

const EXECUTIONS: [Choice; 3] = [
    (
        "lockstep",
        "Tracker and mapper take strict turns: the same result, byte for byte, every time",
    ),
    (
        "parallel",
        "Tracker and mapper run side by side; each frame still gets its iterations",
    ),
    (
        "realtime",
        "Side by side, frames arrive by their time stamps, late ones are dropped",
    ),
];

const BACKENDS: [Choice; 3] = [
    (
        "auto",
        "On a graphics device if there is one, else on the CPU",
    ),
    ("cpu", "On the CPU"),
    (
        "gpu",
        "On a graphics device, even one emulated in software; refused where there is none",
    ),
];

/// Parses `--mode`.
pub fn execution() -> impl TypedValueParser<Value = Execution> {
    one_of(&EXECUTIONS)
}

/// Parses `--backend`.
pub fn backend() -> impl TypedValueParser<Value = Backend> {
    one_of(&BACKENDS)
}

fn one_of<T>(choices: &[Choice]) -> impl TypedValueParser<Value = T>
where
    T: FromStr<Err: std::error::Error + Send + Sync> + Clone + Send + Sync + 'static,
{
    let values = choices
        .iter()
        .map(|(name, help)| PossibleValue::new(*name).help(*help));
    PossibleValuesParser::new(values).try_map(|name| name.parse::<T>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_that_of_a_value() {
        for (name, _) in EXECUTIONS {
            assert_eq!(name.parse::<Execution>().unwrap().to_string(), name);
        }
        for (name, _) in BACKENDS {
            assert_eq!(name.parse::<Backend>().unwrap().to_string(), name);
        }
    }
}
