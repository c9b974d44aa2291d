//! Options that choose a value of the libraries by its name, with a line of help for each name.

use std::str::FromStr;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use fgs_run::{Backend, ExportFormat};
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

const EXPORT_FORMATS: [Choice; 13] = [
    (
        "ply",
        "Gaussians: PLY of the original 3D gaussian splatting",
    ),
    (
        "compressed-ply",
        "Gaussians: PLY of SuperSplat, a quarter of the size",
    ),
    ("splat", "Gaussians: .splat of antimatter15's viewer"),
    ("spz", "Gaussians: Niantic's SPZ, a quarter of the size"),
    (
        "glb",
        "Gaussians: binary glTF with `KHR_gaussian_splatting`",
    ),
    ("points", "Coloured points of the measured surface: PLY"),
    ("mesh-ply", "Coloured mesh of the measured surface: PLY"),
    ("mesh-obj", "The same as OBJ"),
    ("mesh-glb", "The same as binary glTF"),
    ("tum", "Trajectory in TUM's format"),
    ("kitti", "Trajectory in KITTI's format"),
    (
        "colmap",
        "The keyframes' images and poses, and points: COLMAP's text files",
    ),
    ("nerfstudio", "The same for nerfstudio"),
];

/// Parses `--mode`.
pub fn execution() -> impl TypedValueParser<Value = Execution> {
    one_of(&EXECUTIONS)
}

/// Parses `--backend`.
pub fn backend() -> impl TypedValueParser<Value = Backend> {
    one_of(&BACKENDS)
}

/// Parses `--to`.
pub fn export_format() -> impl TypedValueParser<Value = ExportFormat> {
    one_of(&EXPORT_FORMATS)
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
        for (name, _) in EXPORT_FORMATS {
            assert_eq!(name.parse::<ExportFormat>().unwrap().to_string(), name);
        }
    }
}
