//! Settings that differ from the defaults.

use toml::{Table, Value};

use crate::settings::{RunSettings, Settings};

/// A setting with its value and its default, as TOML; empty where there is none.
pub struct SettingChange {
    pub key: String,
    pub value: String,
    pub default: String,
}

/// What differs from the defaults: of the algorithms, and of how the run was started. Not the camera,
/// which is the recording's, and not what names folders of the machine.
pub fn setting_changes(settings: &Settings) -> Vec<SettingChange> {
    let settings = Settings {
        camera: None,
        run: RunSettings {
            command: None,
            dataset: None,
            dataset_frames: None,
            camera_source: None,
            commit: None,
            ..settings.run.clone()
        },
        ..settings.clone()
    };
    let mut changes = Vec::new();
    compare(
        "",
        &table(&settings),
        &table(&Settings::default()),
        &mut changes,
    );
    changes
}

/// Settings that have no TOML form could not have been read.
fn table(settings: &Settings) -> Table {
    Table::try_from(settings).unwrap_or_default()
}

fn compare(prefix: &str, table: &Table, defaults: &Table, changes: &mut Vec<SettingChange>) {
    for (key, value) in table {
        let (key, default) = (format!("{prefix}{key}"), defaults.get(key));
        match (value, default) {
            (Value::Table(inner), default) => {
                let empty = Table::new();
                let defaults = default.and_then(Value::as_table).unwrap_or(&empty);
                compare(&format!("{key}."), inner, defaults, changes);
            }
            (value, Some(default)) if value == default => {}
            (value, default) => changes.push(SettingChange {
                key,
                value: value.to_string(),
                default: default.map(Value::to_string).unwrap_or_default(),
            }),
        }
    }
}
