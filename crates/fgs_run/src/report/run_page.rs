//! The page of one run.

use std::io;

use maud::{Markup, PreEscaped, html};
use plotters::style::RGBColor;

use super::error_colors::ErrorColors;
use super::measures::MEASURES;
use super::numbers::numbers;
use super::page::{legend, number, page};
use super::path_view::{Path, Scene, VIEWS, unbroken};
use super::photos::{DIFFERENCE_SCALE, photos};
use super::plot::{Line, frame_range, line_plot, stretches};
use super::run_data::RunData;
use super::setting_changes::setting_changes;
use super::strips::{KEYFRAMES, VERDICTS, keyframe_strip, verdict_strip};

const LINE: RGBColor = RGBColor(44, 95, 158);
const REFERENCE: RGBColor = RGBColor(170, 170, 170);
const LOST: RGBColor = RGBColor(208, 48, 48);
const KEYFRAME: RGBColor = RGBColor(40, 40, 40);

/// The page.
///
/// # Errors
/// If a plot cannot be drawn.
pub fn run_page(run: &RunData) -> io::Result<String> {
    let title = format!("{} – fgs-slam run", run.name);
    let content = html! {
        h1 { (run.name) }
        (what_ran(run))
        h2 { "Numbers" } (numbers_table(run))
        h2 { "Trajectory" } (trajectory(run)?)
        h2 { "Over the frames" } (over_frames(run)?)
        h2 { "Time" } (times(run))
        (pictures(run))
    };
    Ok(page(&title, &content))
}

fn what_ran(run: &RunData) -> Markup {
    let metrics = &run.metrics;
    let camera = run.settings.camera.as_ref().map(|file| {
        let camera = file.camera();
        let lens = camera.intrinsics;
        let [fx, fy, cx, cy] = [lens.fx, lens.fy, lens.cx, lens.cy].map(number);
        let size = format!("{}x{} pixels", camera.width, camera.height);
        format!("{size}, fx {fx}, fy {fy}, cx {cx}, cy {cy}")
    });
    let changes = setting_changes(&run.settings);
    html! {
        @if metrics.interrupted { p.failure { "Stopped early." } }
        @if let Some(failure) = &metrics.failure { p.failure { "Ended early: " (failure) } }
        table {
            tr { td { "Recording" } td { (run.recording()) } }
            @if let Some(camera) = camera { tr { td { "Camera" } td { (camera) } } }
            tr { td { "Computed on" } td { (metrics.backend) ", " (metrics.threads) " threads, " (metrics.mode) } }
            tr { td { "Seed" } td { (metrics.seed) } }
            tr { td { "Software" } td { "fgs-slam " (env!("CARGO_PKG_VERSION")) ", commit " code { (metrics.commit) } } }
        }
        h3 { "Settings that differ from the defaults" }
        @if changes.is_empty() { p.note { "None." } } @else {
            table {
                tr { th { "Setting" } th { "Value" } th { "Default" } }
                @for change in &changes {
                    tr { td { code { (change.key) } } td { code { (change.value) } } td { code { (change.default) } } }
                }
            }
        }
    }
}

fn numbers_table(run: &RunData) -> Markup {
    let numbers = numbers(run);
    let refined = run.metrics.refined.is_some();
    let known = numbers.iter().filter(|number| number.value.is_some());
    html! {
        table {
            tr {
                th { "Name" } th.number { "Value" }
                @if refined { th.number { "Refined map" } }
                th { "Meaning" }
            }
            @for entry in known {
                tr {
                    td { code { (entry.name) } }
                    td.number { (value(entry.value)) }
                    @if refined { td.number { (value(entry.refined)) } }
                    td.meaning { (entry.meaning) }
                }
            }
        }
        @if numbers.iter().all(|number| number.name != "psnr_db" || number.value.is_none()) {
            p.note { "The map was not compared with the images: " code { "fgs eval" } " does that." }
        }
    }
}

fn value(value: Option<f64>) -> String {
    value.map(number).unwrap_or_default()
}

fn trajectory(run: &RunData) -> io::Result<Markup> {
    if run.positions.iter().all(Option::is_none) {
        return Ok(html! { p.note { "No frame has a pose." } });
    }
    let errors = (0..run.rows.len()).filter_map(|place| run.position_error_m(place));
    let colors = ErrorColors::of(errors);
    let color = |place| match (&colors, run.position_error_m(place)) {
        (Some(colors), Some(error_m)) => colors.color(error_m),
        _ => LINE,
    };
    let mut scene = Scene::default();
    let reference: Vec<_> = run.reference.iter().flatten().copied().collect();
    scene.add_thinned(&reference, 1, REFERENCE);
    let paths = unbroken(run, &run.positions);
    let at = |place: &usize| run.positions[*place];
    for (before, after) in paths.iter().zip(paths.iter().skip(1)) {
        let gap = [before.last(), after.first()].map(|place| place.and_then(at));
        let gap: Vec<_> = gap.into_iter().flatten().collect();
        scene.add_path(&gap, 2, |_| LOST);
    }
    for path in &paths {
        let places: Vec<_> = path.iter().filter_map(at).collect();
        scene.add_path(&places, 2, |end| color(path[end]));
    }
    let keyframes = (0..run.rows.len()).filter(|place| run.rows[*place].keyframe.is_some());
    scene.marks.push(Path {
        color: KEYFRAME,
        width: 2,
        places: keyframes.filter_map(|place| run.positions[place]).collect(),
    });

    let mut entries = colors.as_ref().map(ErrorColors::legend).unwrap_or_default();
    if colors.is_none() {
        entries.push((LINE, "estimated".into()));
    }
    if run.has_reference() {
        entries.push((REFERENCE, "reference".into()));
    }
    entries.push((KEYFRAME, "circles: keyframes".into()));
    if paths.len() > 1 {
        entries.push((LOST, "across frames that were lost".into()));
    }
    let first_lost = run.positions.iter().position(Option::is_some).unwrap_or(0);
    Ok(html! {
        (views(&scene)?)
        (legend(entries.iter().map(|(color, text)| (*color, text.as_str()))))
        p.note {
            "Metres, in the axes of the map's first camera: x right, y down, z forward. "
            @if run.has_reference() { "The reference is aligned by a rigid motion. " }
            @if run.metrics.reference_is_device { "It is the device's own estimate, not the truth. " }
            @else { "The recording has no reference trajectory. " }
            @if first_lost > 0 { "The first pose is that of frame " (run.rows[first_lost].index) "." }
        }
    })
}

/// A scene from every side.
pub fn views(scene: &Scene) -> io::Result<Markup> {
    let mut views = Vec::new();
    for view in &VIEWS {
        views.push((view, scene.draw(view)?));
    }
    Ok(html! {
        div.row {
            @for (view, svg) in &views {
                figure {
                    (PreEscaped(svg))
                    figcaption { (view.name) ": " (view.axes[0]) " to the right, " (view.axes[1]) " upwards" }
                }
            }
        }
    })
}

fn over_frames(run: &RunData) -> io::Result<Markup> {
    let frames = frame_range([run]);
    let mut plots = Vec::new();
    for measure in &MEASURES {
        let stretches = stretches(run, measure.value);
        if !stretches.is_empty() {
            let line = Line {
                color: LINE,
                stretches,
            };
            plots.push((
                measure,
                line_plot(&[line], frames.clone(), measure.from_zero)?,
            ));
        }
    }
    let mut keyframes = Vec::new();
    for (kind, color) in KEYFRAMES {
        let count = run.rows.iter().filter(|row| row.keyframe == Some(kind));
        let strip = keyframe_strip(run, frames.clone(), kind, color)?;
        keyframes.push((kind, count.count(), strip));
    }
    let verdicts = VERDICTS.map(|(status, color)| {
        let count = run.rows.iter().filter(|row| row.status == status).count();
        (color, count, format!("{status} ({count})"))
    });
    let verdicts = verdicts.iter().filter(|(_, count, _)| *count > 0);
    Ok(html! {
        div.plot {
            h3 { "Verdict" }
            (PreEscaped(verdict_strip(run, frames.clone())?))
            (legend(verdicts.map(|(color, _, text)| (*color, text.as_str()))))
        }
        @for (kind, count, strip) in &keyframes {
            div.plot { h3 { "Keyframes for " (kind) " (" (count) ")" } (PreEscaped(strip)) }
        }
        p.note { (run.metrics.loops) " loops were closed. Frames are counted from 0 in the recording." }
        @for (measure, svg) in &plots { (plot(measure, svg)) }
    })
}

/// A plot under its name.
pub fn plot(measure: &super::measures::Measure, svg: &str) -> Markup {
    html! {
        div.plot {
            h3 {
                (measure.name)
                @if !measure.unit.is_empty() { " [" (measure.unit) "]" }
                " " span.note style="font-weight: normal" { "– " (measure.meaning) }
            }
            (PreEscaped(svg))
        }
    }
}

fn times(run: &RunData) -> Markup {
    let metrics = &run.metrics;
    let tried = run.frames_tried();
    let per_frame = |seconds: f64| (tried > 0).then(|| 1e3 * seconds / tried as f64);
    let tracking = run.rows.iter().filter_map(|row| row.tracking_ms);
    let tracking = tracking.filter(|ms| ms.is_finite()).sum::<f64>() / 1e3;
    let mapping = metrics.mapping_ms.map(|ms| ms * tried as f64 / 1e3);
    let wall = metrics.fps.map(|fps| metrics.frames as f64 / fps);
    let stages = [
        ("Tracking", Some(tracking)),
        ("Mapping", mapping),
        ("Whole run without refinement, by the clock", wall),
    ];
    html! {
        table {
            tr { th { "Stage" } th.number { "Seconds" } th.number { "ms per frame" } }
            @for (stage, seconds) in stages {
                @if let Some(seconds) = seconds {
                    tr {
                        td { (stage) }
                        td.number { (format!("{seconds:.1}")) }
                        td.number { (per_frame(seconds).map(|ms| format!("{ms:.1}")).unwrap_or_default()) }
                    }
                }
            }
            @if let Some(refined) = &metrics.refined {
                tr { td { "Refinement, " (refined.steps) " steps" } td.number { (format!("{:.1}", refined.seconds)) } td {} }
            }
        }
        p.note { "Tracking and mapping go on at the same time except in lockstep." }
    }
}

fn pictures(run: &RunData) -> Markup {
    let photos = photos(run);
    html! {
        @if !photos.is_empty() {
            h2 { "Frames" }
            p.note { "Camera, map, and their difference times " (DIFFERENCE_SCALE) "." }
            @for photo in &photos {
                figure style="margin: 8px 0" {
                    figcaption { (photo.name) (psnr(run, &photo.name)) }
                    div.row {
                        @for (picture, text) in photo.pictures.iter().zip(["camera", "map", "difference"]) {
                            img src=(picture) alt=(text) {}
                        }
                    }
                }
            }
        }
    }
}

/// How well the map shows the frame that a picture's name ends with.
fn psnr(run: &RunData, name: &str) -> String {
    let index = name.rsplit('-').next().and_then(|index| index.parse().ok());
    let row = index.and_then(|index: usize| run.rows.iter().find(|row| row.index == index));
    let psnr = row.and_then(|row| row.scores.get("psnr_valid_depth_db"));
    psnr.map(|psnr| format!(", {psnr:.2} dB"))
        .unwrap_or_default()
}
