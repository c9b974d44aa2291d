//! A single setting as text: `mapping.prune_every=200`.

use toml::Table;

use crate::settings::{Settings, one_line};

/// The settings with one assignment made.
///
/// # Errors
/// Says in one line what is wrong with the key or the value.
pub fn assign(settings: &Settings, assignment: &str) -> Result<Settings, String> {
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
    let mut table = Table::try_from(settings).map_err(|error| error.to_string())?;
    overlay(&mut table, change);
    let settings: Settings = table
        .try_into()
        .map_err(|error| one_line(&error.to_string()))?;
    settings
        .slam()
        .validate()
        .map_err(|error| error.to_string())?;
    Ok(settings)
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

#[cfg(test)]
mod tests {
    use fgs_slam::SlamConfig;

    use super::*;

    fn assign(assignments: &[&str]) -> Result<Settings, String> {
        let assignments: Vec<_> = assignments.iter().map(|s| (*s).to_owned()).collect();
        Settings::load(None, &assignments).map_err(|error| error.to_string())
    }

    #[test]
    fn assignments_go_over_everything_else() {
        let settings = assign(&[
            "mapping.prune_every=50",
            "seeding.depth_mask=true",
            "surface.noise_power=1.5",
            "seeding.min_alpha=1",
            "mapping.prune_every=60",
            "run.frames=\"3..9\"",
        ]);
        let slam = settings.unwrap().slam();
        assert_eq!(slam.mapping.prune_every, 60);
        assert!(slam.seeding.depth_mask);
        assert_eq!(slam.surface.noise_power, 1.5);
        assert_eq!(slam.seeding.min_alpha, 1.0);
        assert_eq!(
            slam.mapping.max_keyframes,
            SlamConfig::default().mapping.max_keyframes
        );
    }

    #[test]
    fn bad_assignments_are_named() {
        for (assignment, expected) in [
            ("mapping.prune_every", "expected key=value"),
            ("mapping.prune_evry=3", "unknown field `prune_evry`"),
            ("mapping=3", "3 is given where a table is expected"),
            (
                "mapping.prune_every=0",
                "mapping.prune_every = 0 is not possible",
            ),
            (
                "mapping.prune_every=often",
                "\"often\" is given where a whole number",
            ),
            ("mapping.prune_every=]", "mapping.prune_every=]: "),
            ("camera.fx=500", "missing field"),
        ] {
            let message = assign(&[assignment]).unwrap_err();
            assert!(message.starts_with(&format!("{assignment}: ")), "{message}");
            assert!(message.contains(expected), "{message}");
            assert_eq!(message.lines().count(), 1, "{message}");
        }
    }
}
