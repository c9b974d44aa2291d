//! Several runs on one page.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;

use maud::{PreEscaped, html};
use plotters::style::RGBColor;

use super::measures::MEASURES;
use super::numbers::numbers;
use super::page::{legend, number, page};
use super::path_view::{Scene, unbroken};
use super::plot::{Line, frame_range, line_plot, stretches};
use super::plot_error;
use super::run_data::RunData;
use super::run_page::{plot, views};
use super::setting_changes::setting_changes;
use super::strips::{VERDICTS, verdict_strip};
use crate::error::RunError;
use crate::run_folder::{REPORT, RunFolder};

/// Of runs beyond these, colours come again.
const COLORS: [RGBColor; 8] = [
    RGBColor(31, 100, 180),
    RGBColor(225, 110, 20),
    RGBColor(45, 145, 60),
    RGBColor(150, 80, 180),
    RGBColor(200, 40, 50),
    RGBColor(120, 85, 70),
    RGBColor(220, 100, 180),
    RGBColor(100, 100, 100),
];

/// A page with the numbers of runs side by side and their plots over each other.
///
/// # Errors
/// If a folder is not that of a run, or a result is missing or damaged.
pub fn comparison_page(folders: &[impl AsRef<Path>]) -> Result<String, RunError> {
    let read = |folder: &_| RunData::read(&RunFolder::open(AsRef::as_ref(folder))?);
    let runs: Vec<RunData> = folders.iter().map(read).collect::<Result<_, _>>()?;
    compare(&runs).map_err(|source| plot_error(REPORT.into(), source))
}

fn compare(runs: &[RunData]) -> io::Result<String> {
    let colored = || runs.iter().zip(COLORS.into_iter().cycle());
    let all: Vec<_> = runs.iter().map(numbers).collect();
    let rows = (0..all.first().map_or(0, Vec::len)).map(|place| {
        let of_runs = all.iter().map(move |numbers| &numbers[place]);
        of_runs.collect::<Vec<_>>()
    });
    let rows = rows.filter(|row| row.iter().any(|number| number.value.is_some()));
    let frames = frame_range(runs);
    let mut plots = Vec::new();
    for measure in &MEASURES {
        let lines = colored().map(|(run, color)| Line {
            color,
            stretches: stretches(run, measure.value),
        });
        let lines: Vec<_> = lines.collect();
        if lines.iter().any(|line| !line.stretches.is_empty()) {
            plots.push((
                measure,
                line_plot(&lines, frames.clone(), measure.from_zero)?,
            ));
        }
    }
    let mut verdicts = Vec::new();
    let mut scene = Scene::default();
    for (run, color) in colored() {
        verdicts.push((run, verdict_strip(run, frames.clone())?));
        for path in unbroken(run, &run.positions) {
            let places: Vec<_> = path
                .iter()
                .filter_map(|place| run.positions[*place])
                .collect();
            scene.add_path(&places, 1, |_| color);
        }
    }
    let settings = differing_settings(runs);
    let statuses = VERDICTS.map(|(status, color)| (color, status.to_string()));
    let names = legend(colored().map(|(run, color)| (color, run.name.as_str())));
    let content = html! {
        h1 { "Comparison of " (runs.len()) " runs" }
        (names)
        h2 { "Numbers" }
        table {
            tr { th { "Name" } @for run in runs { th.number { (run.name) } } th { "Meaning" } }
            tr { td { "recording" } @for run in runs { td.number { (run.recording()) } } td.meaning { "what was run" } }
            tr { td { "computed on" } @for run in runs { td.number { (run.metrics.backend) } } td {} }
            @for row in rows {
                tr {
                    td { code { (row[0].name) } }
                    @for entry in &row { td.number { (entry.value.map(number).unwrap_or_default()) } }
                    td.meaning { (row[0].meaning) }
                }
            }
        }
        h3 { "Settings that differ" }
        @if settings.is_empty() { p.note { "None." } } @else {
            table {
                tr { th { "Setting" } @for run in runs { th { (run.name) } } }
                @for (key, values) in &settings {
                    tr { td { code { (key) } } @for value in values { td { code { (value) } } } }
                }
            }
        }
        h2 { "Trajectories" } (views(&scene)?)
        p.note { "Metres, each in the axes of its own map's first camera." }
        h2 { "Over the frames" } (names)
        @for (run, strip) in &verdicts { div.plot { h3 { "Verdict of " (run.name) } (PreEscaped(strip)) } }
        (legend(statuses.iter().map(|(color, text)| (*color, text.as_str()))))
        @for (measure, svg) in &plots { (plot(measure, svg)) }
    };
    Ok(page("Comparison of fgs-slam runs", &content))
}

/// Settings that are not the same in all runs, with the value in each; empty where a setting was not given
/// and has no default.
fn differing_settings(runs: &[RunData]) -> BTreeMap<String, Vec<String>> {
    let mut settings: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (place, run) in runs.iter().enumerate() {
        for change in setting_changes(&run.settings) {
            let defaults = || vec![change.default; runs.len()];
            settings.entry(change.key).or_insert_with(defaults)[place] = change.value;
        }
    }
    settings.retain(|_, values| values.iter().any(|value| *value != values[0]));
    settings
}
