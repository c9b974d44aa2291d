//! The settings of a run: defaults, then a TOML file, then single assignments `key=value`, each
//! overriding those before.
//!
//! Unknown keys and impossible values are refused, with file and line or with the assignment they
//! came from.

use std::path::{Path, PathBuf};

use fgs_data::{CameraFile, plain_words};
use fgs_slam::{
    Execution, Holdout, KeyframeConfig, LoopConfig, MappingConfig, SeedingConfig, SlamConfig,
    SurfaceConfig, TrackingConfig,
};
use serde::{Deserialize, Serialize};
use toml::de::DeTable;

use crate::assignment::assign;
use crate::backend::Backend;
use crate::error::RunError;
use crate::frame_range::FrameRange;

/// The commit that this library was built from; "unknown" without git.
pub const COMMIT: &str = env!("FGS_COMMIT");

/// All settings with comments take 10 kB.
const MAX_BYTES: u64 = 1 << 20;

/// A settings file: every group of [`SlamConfig`], the camera, and what a run records about itself, so
/// that its effective settings repeat it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Seed of the random choice of the keyframe to optimise next.
    pub seed: u64,
    /// See [`SlamConfig`].
    pub tracking: TrackingConfig,
    /// See [`SlamConfig`].
    pub surface: SurfaceConfig,
    /// See [`SlamConfig`].
    pub keyframes: KeyframeConfig,
    /// See [`SlamConfig::loops`].
    pub loops: LoopConfig,
    /// See [`SlamConfig`].
    pub seeding: SeedingConfig,
    /// See [`SlamConfig`].
    pub mapping: MappingConfig,
    /// The recording's camera, where it does not have its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera: Option<CameraFile>,
    /// How the run is started.
    pub run: RunSettings,
}

/// The `[run]` table. `mode`, `backend`, `frames`, `refine`, `eval_holdout`,
/// `checkpoint_every_secs` and `camera_overrides` apply
/// unless [`RunOptions`](crate::RunOptions) say otherwise; the rest is for people and for scoring the run
/// again.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RunSettings {
    /// The command line, if there was one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub command: Option<String>,
    /// The recording, as seen from the run's folder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dataset: Option<PathBuf>,
    /// Its number of frames.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dataset_frames: Option<usize>,
    /// The live camera, if the frames came from one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera_source: Option<String>,
    /// How tracker and mapper took turns.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mode: Option<Execution>,
    /// Where the map was optimised.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub backend: Option<Backend>,
    /// The frames of the recording.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<FrameRange>,
    /// Optimisation steps after the last frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refine: Option<usize>,
    /// Of every so many frames, the last is kept out of the map.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub eval_holdout: Option<Holdout>,
    /// Seconds between checkpoints of the map (0: after every frame); none are written without.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub checkpoint_every_secs: Option<u64>,
    /// Whether `[camera]` applies even where the recording has its own, as a camera file given for
    /// the run does.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera_overrides: Option<bool>,
    /// The commit that the software was built from.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub commit: Option<String>,
}

impl Default for Settings {
    fn default() -> Self {
        let SlamConfig {
            seed,
            tracking,
            surface,
            keyframes,
            loops,
            seeding,
            mapping,
        } = SlamConfig::default();
        Self {
            seed,
            tracking,
            surface,
            keyframes,
            loops,
            seeding,
            mapping,
            camera: None,
            run: RunSettings::default(),
        }
    }
}

impl Settings {
    /// The settings of a file, changed by assignments `key=value`, where the key is dotted and the
    /// value TOML (quotes around a single word may be left out).
    ///
    /// # Errors
    /// [`RunError::Settings`] or [`RunError::Assignment`], for what is refused.
    pub fn load(file: Option<&Path>, assignments: &[String]) -> Result<Self, RunError> {
        let settings = match file {
            Some(path) => Self::read(path)?,
            None => Self::default(),
        };
        settings.assigned(assignments)
    }

    /// The same, changed by assignments as [`load`](Self::load) takes them.
    ///
    /// # Errors
    /// [`RunError::Assignment`], for what is refused.
    pub fn assigned(self, assignments: &[String]) -> Result<Self, RunError> {
        assignments.iter().try_fold(self, |settings, text| {
            assign(&settings, text).map_err(|message| RunError::Assignment {
                assignment: text.clone(),
                message,
            })
        })
    }

    /// The settings of a file.
    ///
    /// # Errors
    /// [`RunError::Settings`] if the file cannot be read, or a key or value is refused.
    pub fn read(path: &Path) -> Result<Self, RunError> {
        let refusal = |line, message| RunError::Settings {
            path: path.into(),
            line,
            message,
        };
        let text = fgs_files::read_text(path, MAX_BYTES)
            .map_err(|error| refusal(None, error.to_string()))?;
        let line = |at: usize| line_at(&text, at);
        let settings: Self = toml::from_str(&text).map_err(|error| {
            let at = error.span().map(|span| span.start);
            refusal(at.map(line), one_line(error.message()))
        })?;
        settings.slam().validate().map_err(|error| {
            let at = position_of(&text, &error.key);
            refusal(at.map(line), error.to_string())
        })?;
        Ok(settings)
    }

    /// What the algorithms read.
    pub fn slam(&self) -> SlamConfig {
        SlamConfig {
            seed: self.seed,
            tracking: self.tracking.clone(),
            surface: self.surface.clone(),
            keyframes: self.keyframes.clone(),
            loops: self.loops.clone(),
            seeding: self.seeding.clone(),
            mapping: self.mapping.clone(),
        }
    }

    /// The same algorithms and camera, but nothing of how the run was started.
    pub(crate) fn of_another_run(self) -> Self {
        Self {
            run: RunSettings {
                camera_overrides: self.run.camera_overrides,
                ..RunSettings::default()
            },
            ..self
        }
    }

    /// As TOML that [`Settings::read`] reads back.
    ///
    /// # Errors
    /// [`RunError::NotToml`] if a value has no TOML form, such as a seed over 2^63.
    pub fn to_toml(&self) -> Result<String, RunError> {
        toml::to_string(self).map_err(|error| RunError::NotToml(one_line(&error.to_string())))
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

/// A parser's message in one line and in plain words.
pub(crate) fn one_line(message: &str) -> String {
    plain_words(&message.lines().map(str::trim).collect::<Vec<_>>().join(" "))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn read(text: &str) -> Result<Settings, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.toml");
        fs::write(&path, text).unwrap();
        Settings::read(&path).map_err(|error| {
            let message = error.to_string();
            assert!(error.is_usage(), "{message}");
            let (_, after) = message.split_once("c.toml").unwrap();
            after.to_owned()
        })
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
                ":2: \"often\" is given where a whole number",
            ),
            ("seed = \n", ":1: "),
            ("[camera]\nwidth = 640", ":1: missing field"),
            ("[run]\nmode = 'fast'", ":2: unknown choice `fast`"),
            ("[run]\nbackend = 'abacus'", ":2: unknown choice `abacus`"),
            (
                "[run]\neval_holdout = 1",
                ":2: one frame in 1 cannot be held out",
            ),
            ("[run]\nframes = '7'", ":2: '7' is not a range"),
        ] {
            let message = read(text).unwrap_err();
            assert!(message.starts_with(expected), "{text:?}: {message}");
            assert_eq!(message.lines().count(), 1, "{message}");
        }
    }

    #[test]
    fn what_is_written_is_read() {
        let assignments = ["seeding.min_alpha=0.3".to_owned()];
        let mut settings = Settings::load(None, &assignments).unwrap();
        settings.run = RunSettings {
            command: Some("fgs run \"a b\"".into()),
            dataset: Some("a b".into()),
            dataset_frames: Some(12),
            camera_source: Some("ros2:/camera".into()),
            mode: Some(Execution::Lockstep),
            backend: Some(Backend::Cpu),
            frames: Some((2..8).into()),
            refine: Some(30),
            eval_holdout: Some(Holdout::every(8).unwrap()),
            checkpoint_every_secs: Some(60),
            camera_overrides: None,
            commit: Some("unknown".into()),
        };
        let text = settings.to_toml().unwrap();
        assert!(text.contains("min_alpha = 0.3\n"), "{text}");
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
