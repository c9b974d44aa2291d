//! The settings of a run: defaults, then a TOML file, then `--set key=value`, each over the one
//! before.
//!
//! Unknown keys and impossible values are refused with file and line, or with the `--set` that
//! brought them.

use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::Context;
use fgs_data::CameraFile;
use fgs_slam::{
    ConfigError, KeyframeConfig, MappingConfig, SeedingConfig, SlamConfig, TrackingConfig,
};
use serde::{Deserialize, Serialize};
use toml::Table;
use toml::de::DeTable;

use crate::backend::Backend;
use crate::failure::UsageError;
use crate::frame_range::FrameRange;
use crate::mode::Mode;

/// The commit this program was built from.
pub const COMMIT: &str = env!("FGS_COMMIT");

/// A configuration file: every group of [`SlamConfig`], the camera, and what a run records of
/// itself so that its effective configuration reruns it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Seed of the random choice of views.
    pub seed: u64,
    /// See [`SlamConfig`].
    pub tracking: TrackingConfig,
    /// See [`SlamConfig`].
    pub keyframes: KeyframeConfig,
    /// See [`SlamConfig`].
    pub seeding: SeedingConfig,
    /// See [`SlamConfig`].
    pub mapping: MappingConfig,
    /// The recording's camera, where it does not bring its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera: Option<CameraFile>,
    /// How the run was started.
    pub run: RunSettings,
}

/// The `[run]` table. `mode`, `backend`, `frames` and `camera_overrides` hold unless the command line
/// says otherwise; the rest is for people and for `fgs eval`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RunSettings {
    /// The command line as typed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub command: Option<String>,
    /// The recording as typed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dataset: Option<PathBuf>,
    /// How tracker and mapper took turns.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mode: Option<Mode>,
    /// Where the map was optimised.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub backend: Option<Backend>,
    /// The frames of the recording.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<FrameRange>,
    /// Whether `[camera]` holds even where the recording brings its own, as `--camera` does.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera_overrides: Option<bool>,
    /// The program's commit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub commit: Option<String>,
}

impl Default for Settings {
    fn default() -> Self {
        let SlamConfig {
            seed,
            tracking,
            keyframes,
            seeding,
            mapping,
        } = SlamConfig::default();
        Self {
            seed,
            tracking,
            keyframes,
            seeding,
            mapping,
            camera: None,
            run: RunSettings::default(),
        }
    }
}

impl Settings {
    /// The settings after a file and assignments `key=value`, where the key is dotted and the value
    /// TOML (quotes around a word may be left out).
    ///
    /// # Errors
    /// The file cannot be read; a [`UsageError`] for a key or a value that is refused.
    pub fn load(file: Option<&Path>, assignments: &[String]) -> anyhow::Result<Self> {
        let mut settings = match file {
            Some(path) => Self::read(path)?,
            None => Self::default(),
        };
        for assignment in assignments {
            settings = settings
                .assign(assignment)
                .map_err(|reason| UsageError(format!("--set {assignment}: {reason}")))?;
        }
        Ok(settings)
    }

    /// The settings after a file alone.
    ///
    /// # Errors
    /// The file cannot be read; a [`UsageError`] for a key or a value that is refused.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let text = fs::read_to_string(path)
            .map_err(|error| UsageError(format!("cannot read {}: {error}", path.display())))?;
        let refusal = |at: Option<usize>, message: &str| {
            let line = at
                .map(|at| format!(":{}", line_at(&text, at)))
                .unwrap_or_default();
            UsageError(format!("{}{line}: {message}", path.display()))
        };
        let settings: Self = toml::from_str(&text).map_err(|error| {
            refusal(
                error.span().map(|span| span.start),
                &one_line(error.message()),
            )
        })?;
        settings
            .slam()
            .validate()
            .map_err(|error| refusal(position_of(&text, error.key), &error.to_string()))?;
        Ok(settings)
    }

    /// What the algorithms read.
    pub fn slam(&self) -> SlamConfig {
        SlamConfig {
            seed: self.seed,
            tracking: self.tracking.clone(),
            keyframes: self.keyframes.clone(),
            seeding: self.seeding.clone(),
            mapping: self.mapping.clone(),
        }
    }

    /// Notes how a run is started, so that these settings rerun it.
    pub fn record_run(
        &mut self,
        dataset: &Path,
        mode: Mode,
        backend: Backend,
        frames: &Range<usize>,
    ) {
        self.run = RunSettings {
            command: Some(std::env::args().collect::<Vec<_>>().join(" ")),
            dataset: Some(dataset.into()),
            mode: Some(mode),
            backend: Some(backend),
            frames: Some(frames.clone().into()),
            camera_overrides: self.run.camera_overrides,
            commit: Some(COMMIT.into()),
        };
    }

    /// As TOML that [`Settings::read`] reads back.
    ///
    /// # Errors
    /// If a value has no TOML form, such as a seed over 2^63.
    pub fn to_toml(&self) -> anyhow::Result<String> {
        toml::to_string(self).context("the settings have no TOML form")
    }

    fn assign(&self, assignment: &str) -> Result<Self, String> {
        let (key, value) = assignment.split_once('=').ok_or("expected key=value")?;
        let parse = |value: &str| toml::from_str::<Table>(&format!("{key} = {value}"));
        let is_word = value
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || "_-".contains(c));
        let change = parse(value)
            .or_else(|error| {
                if is_word {
                    parse(&format!("'{value}'"))
                } else {
                    Err(error)
                }
            })
            .map_err(|error| one_line(error.message()))?;
        let mut table = Table::try_from(self).map_err(|error| error.to_string())?;
        overlay(&mut table, change);
        let settings: Self = table
            .try_into()
            .map_err(|error| one_line(&error.to_string()))?;
        settings
            .slam()
            .validate()
            .map_err(|error: ConfigError| error.to_string())?;
        Ok(settings)
    }
}

/// Puts every value of `change` into `table`, group by group.
fn overlay(table: &mut Table, change: Table) {
    for (key, value) in change {
        match (table.get_mut(&key), value) {
            (Some(toml::Value::Table(group)), toml::Value::Table(change)) => overlay(group, change),
            (_, value) => {
                table.insert(key, value);
            }
        }
    }
}

/// Where in a TOML text the value of a dotted key stands.
fn position_of(text: &str, dotted: &str) -> Option<usize> {
    let document = DeTable::parse(text).ok()?;
    let mut table = document.get_ref();
    let mut position = None;
    for key in dotted.split('.') {
        let value = table.get(key)?;
        position = Some(value.span().start);
        match value.get_ref().as_table() {
            Some(inner) => table = inner,
            None => return position,
        }
    }
    position
}

fn line_at(text: &str, position: usize) -> usize {
    let before = text.as_bytes().iter().take(position);
    1 + before.filter(|byte| **byte == b'\n').count()
}

fn one_line(message: &str) -> String {
    message.lines().map(str::trim).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Settings, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.toml");
        fs::write(&path, text).unwrap();
        Settings::read(&path).map_err(|error| {
            let message = error.to_string();
            assert_eq!(crate::failure::exit_code(&error), 2);
            let (_, after) = message.split_once("c.toml").unwrap();
            after.to_owned()
        })
    }

    fn assign(assignments: &[&str]) -> Result<Settings, String> {
        let assignments: Vec<_> = assignments.iter().map(|s| (*s).to_owned()).collect();
        Settings::load(None, &assignments).map_err(|error| error.to_string())
    }

    #[test]
    fn a_part_of_the_keys_is_enough() {
        let settings = read("seed = 7\n[mapping]\nprune_every = 50\n").unwrap();
        let mut expected = SlamConfig {
            seed: 7,
            ..SlamConfig::default()
        };
        expected.mapping.prune_every = 50;
        assert_eq!(settings.slam(), expected);
        assert_eq!(read("").unwrap(), Settings::default());
    }

    #[test]
    fn refusals_name_line_and_key() {
        for (text, expected) in [
            (
                "[mapping]\n\nprune_evry = 5",
                ":3: unknown field `prune_evry`",
            ),
            ("[maping]\nprune_every = 5", ":1: unknown field `maping`"),
            (
                "seed = 1\n[mapping]\nprune_every = 0",
                ":3: mapping.prune_every = 0 is not",
            ),
            (
                "mapping.learning_rates.sh = nan",
                ":1: mapping.learning_rates.sh = NaN",
            ),
            (
                "[mapping]\nprune_every = 'often'",
                ":2: invalid type: string",
            ),
            ("seed = \n", ":1: "),
            ("[camera]\nwidth = 640", ":1: missing field"),
            ("[run]\nmode = 'fast'", ":2: unknown variant `fast`"),
            ("[run]\nbackend = 'abacus'", ":2: unknown variant `abacus`"),
            ("[run]\nframes = '7'", ":2: '7' is not a range"),
        ] {
            let message = read(text).unwrap_err();
            assert!(message.starts_with(expected), "{text:?}: {message}");
            assert_eq!(message.lines().count(), 1, "{message}");
        }
    }

    #[test]
    fn assignments_go_over_everything_else() {
        let settings = assign(&[
            "mapping.prune_every=50",
            "tracking.target=neighbors",
            "seeding.clahe=false",
            "seeding.min_alpha=1",
            "mapping.prune_every=60",
            "run.frames=\"3..9\"",
        ]);
        let slam = settings.unwrap().slam();
        assert_eq!(slam.mapping.prune_every, 60);
        assert_eq!(slam.tracking.target, fgs_slam::TargetCovariance::Neighbors);
        assert!(!slam.seeding.clahe);
        assert_eq!(slam.seeding.min_alpha, 1.0);
        assert_eq!(
            slam.mapping.prune_opacity,
            SlamConfig::default().mapping.prune_opacity
        );
    }

    #[test]
    fn bad_assignments_are_named() {
        for (assignment, expected) in [
            ("mapping.prune_every", "expected key=value"),
            ("mapping.prune_evry=3", "unknown field `prune_evry`"),
            ("mapping=3", "invalid type"),
            (
                "mapping.prune_every=0",
                "mapping.prune_every = 0 is not possible",
            ),
            (
                "mapping.prune_every=often",
                "invalid type: string \"often\"",
            ),
            ("mapping.prune_every=]", "--set mapping.prune_every=]"),
            ("camera.fx=500", "missing field"),
        ] {
            let message = assign(&[assignment]).unwrap_err();
            assert!(
                message.starts_with(&format!("--set {assignment}: ")),
                "{message}"
            );
            assert!(message.contains(expected), "{message}");
            assert_eq!(message.lines().count(), 1, "{message}");
        }
    }

    #[test]
    fn what_is_written_is_read() {
        let mut settings = assign(&["mapping.prune_opacity=0.3"]).unwrap();
        settings.run = RunSettings {
            command: Some("fgs run \"a b\"".into()),
            dataset: Some("a b".into()),
            mode: Some(Mode::Lockstep),
            backend: Some(Backend::Cpu),
            frames: Some((2..8).into()),
            camera_overrides: None,
            commit: Some("unknown".into()),
        };
        let text = settings.to_toml().unwrap();
        assert!(text.contains("prune_opacity = 0.3\n"), "{text}");
        assert_eq!(read(&text).unwrap(), settings);
    }

    #[test]
    fn every_file_in_configs_is_accepted() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
        let mut count = 0;
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let settings = Settings::read(&path).unwrap();
            assert!(settings.camera.is_some(), "{}", path.display());
            count += 1;
        }
        assert_eq!(count, 4);
    }
}
