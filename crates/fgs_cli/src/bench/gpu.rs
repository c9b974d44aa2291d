//! The optimisation step on a graphics device.
//!
//! Each stage by the device's clock, in a pass of its own; those of one name in a step, as the passes
//! of the sorts, are added up. Then the step as it really is, many on their way at once, by the wall
//! clock: on one view, and alternating between several as a run does. The floor of a step is the sum of
//! its stages': each begins when the one before has ended. At last what a new keyframe asks for, by
//! the wall clock with the device's answer waited for.

use std::time::Instant;

use anyhow::Context;
use fgs_geom::KeyframeId;
use fgs_splat::{
    GaussianModel, GpuDevice, GpuError, GpuModel, ModelError, ModelSettings, PruneRule, Rates,
    Seeds, TimedStep,
};
use serde::Serialize;

use super::gpu_floors::{NOMINAL, Work, floor_ms};
use super::input::Input;
use super::scene::{Scene, check_fall};
use super::stage::{RUNS, Times};
use crate::console::Console;
use crate::failure::{EXIT_DONE, UsageError};

/// Steps are timed together: as many as take so long, but no more than this number.
const TOGETHER_MS: f64 = 200.0;
const MOST_TOGETHER: f64 = 100.0;
/// Views that steps alternate between.
const VIEWS: u32 = 8;
/// A keyframe brings so many times fewer gaussians than there are.
const NEW_SHARE: usize = 100;

/// One line of the table.
#[derive(Serialize)]
struct Row<'a> {
    input: &'a str,
    stage: &'a str,
    gaussians: usize,
    work: &'a str,
    median_ms: f64,
    best_ms: f64,
    /// At this device's rates. `null` if not known.
    floor_ms: Option<f64>,
    /// The floor at [`NOMINAL`] rates.
    nominal_floor_ms: Option<f64>,
}

/// How much there is to do, and the memory that it takes.
#[derive(Serialize)]
struct Size<'a> {
    input: &'a str,
    gaussians: usize,
    /// `null` if the device has no clock.
    in_view: Option<usize>,
    entries: Option<usize>,
    longest_list: Option<usize>,
    most_tiles: Option<usize>,
    device_bytes: u64,
}

/// Times a step with each of the numbers of gaussians on all inputs. Scenes that the device cannot
/// hold are left out.
///
/// # Errors
/// If there is no device, it fails, or steps do not lower the loss.
pub fn run(inputs: &[Input], numbers: &[usize], console: Console) -> anyhow::Result<u8> {
    let device = GpuDevice::find(true, fgs_run::pipeline_cache_folder().as_deref())
        .map_err(|error| UsageError(error.to_string()))?;
    let rates = device.measure_rates()?;
    let costs = device.measure_dispatch_costs()?;
    console.say(format!(
        "{}: {:.1} GB/s, {:.0} GFLOP/s; nominal: {:.1} GB/s, {:.0} GFLOP/s",
        device.name(),
        1e-9 * rates.bytes_per_sec,
        1e-9 * rates.flops_per_sec,
        1e-9 * NOMINAL.bytes_per_sec,
        1e-9 * NOMINAL.flops_per_sec,
    ));
    console.event(
        "machine",
        serde_json::json!({
            "device": device.name(),
            "bytes_per_sec": rates.bytes_per_sec,
            "flops_per_sec": rates.flops_per_sec,
            "caveats": device.caveats(),
            "dispatch_secs": costs.direct_secs,
            "indirect_dispatch_secs": costs.indirect_secs,
        }),
    );
    console.say(format!(
        "an empty dispatch and its barrier: {:.2} us, {:.2} us with its size on the device",
        1e6 * costs.direct_secs,
        1e6 * costs.indirect_secs
    ));
    for caveat in device.caveats() {
        console.say(format!("note: {caveat}"));
    }
    console.say(format!(
        "\n{:<10} {:<28} {:<44}  median ms    best ms   floor ms nominal ms",
        "input", "stage", "work"
    ));
    for input in inputs {
        for &count in numbers {
            let outcome = bench(input, count, &device, &rates, console)
                .with_context(|| format!("{count} gaussians on {}", input.name));
            match outcome {
                Err(error) if is_too_large(&error) => console.say(format!("left out: {error:#}")),
                outcome => outcome?,
            }
        }
    }
    Ok(EXIT_DONE)
}

fn bench(
    input: &Input,
    count: usize,
    device: &GpuDevice,
    rates: &Rates,
    console: Console,
) -> anyhow::Result<()> {
    let scene = Scene::new(&input.frames[0], count)?;
    let mut model = GpuModel::new(device.clone(), &ModelSettings::default())?;
    let id = scene.fill(&mut model)?;
    steps(&mut model, &[id], 2)?;
    check_fall(&model.take_stats())?;

    let mut runs = Vec::new();
    for _ in 0..RUNS {
        runs.extend(model.timed_step(id)?);
    }
    let work = runs.last().map(|step| Work {
        gaussians: count,
        in_view: step.in_view,
        entries: step.entries,
        pixels: scene.view.camera.width * scene.view.camera.height,
    });
    let words = match &work {
        Some(work) => format!(
            "{count} gaussians, {:.2}M entries",
            1e-6 * work.entries as f64
        ),
        None => format!("{count} gaussians"),
    };
    // Stages that are not known are left out of a step's floor, which is only lower for it.
    let print = |stage: &str, stages: &[Stage], times: Times| {
        let floor = |rates| {
            let floors = stages
                .iter()
                .filter_map(|(name, _)| floor_ms(name, work.as_ref()?, rates));
            floors.reduce(|sum, floor| sum + floor)
        };
        let row = Row {
            input: &input.name,
            stage,
            gaussians: count,
            work: &words,
            median_ms: times.median_ms,
            best_ms: times.best_ms,
            floor_ms: floor(rates),
            nominal_floor_ms: floor(&NOMINAL),
        };
        let number = |ms: Option<f64>| ms.map_or_else(|| "-".to_owned(), |ms| format!("{ms:.4}"));
        console.say(format!(
            "{:<10} {:<28} {:<44} {:>10.3} {:>10.3} {:>10} {:>10}",
            row.input,
            row.stage,
            row.work,
            row.median_ms,
            row.best_ms,
            number(row.floor_ms),
            number(row.nominal_floor_ms),
        ));
        console.event("stage", &row);
    };
    let stages = by_stage(&runs);
    if stages.is_empty() {
        console.say("the device has no clock: stages are not timed");
    } else {
        for stage in &stages {
            print(
                stage.0,
                std::slice::from_ref(stage),
                Times::of(stage.1.clone()),
            );
        }
        let sums = runs
            .iter()
            .map(|step| step.stages.iter().map(|(_, ms)| ms).sum());
        print("sum of stages", &stages, Times::of(sums.collect()));
    }

    let start = Instant::now();
    steps(&mut model, &[id], 2)?;
    let step_ms = 0.5e3 * start.elapsed().as_secs_f64();
    let together = (TOGETHER_MS / step_ms).clamp(2.0, MOST_TOGETHER) as usize;
    let views: Vec<KeyframeId> = (id.0..id.0 + VIEWS).map(KeyframeId).collect();
    for other in &views[1..] {
        model.add_view(*other, scene.view, scene.target.clone())?;
    }
    for (name, views) in [
        ("whole step, one view", &views[..1]),
        ("whole step", &views[..]),
    ] {
        let mut outcome = Ok(());
        let times = Times::measure(&mut || {
            if outcome.is_ok() {
                outcome = steps(&mut model, views, together);
            }
        });
        outcome?;
        let each = |ms| ms / together as f64;
        let times = Times {
            median_ms: each(times.median_ms),
            best_ms: each(times.best_ms),
        };
        print(name, &stages, times);
    }
    for (name, times) in time_keyframe(&mut model, &scene)? {
        print(name, &[], Times::of(times));
    }

    let last = runs.last();
    let size = Size {
        input: &input.name,
        gaussians: count,
        in_view: work.map(|work| work.in_view),
        entries: work.map(|work| work.entries),
        longest_list: last.map(|step| step.longest_list),
        most_tiles: last.map(|step| step.most_tiles),
        device_bytes: model.device_bytes(),
    };
    console.say(format!(
        "{:<10} {:<28} {words:<44} {:.1} MB",
        size.input,
        "device memory",
        1e-6 * size.device_bytes as f64
    ));
    if let (Some(longest_list), Some(most_tiles)) = (size.longest_list, size.most_tiles) {
        console.say(format!(
            "{:<10} {:<28} {longest_list} gaussians in a tile, {most_tiles} tiles of a gaussian",
            size.input, "longest list"
        ));
    }
    console.event("scene", &size);
    Ok(())
}

/// Whether a scene is more than the device can hold, which says nothing of the others.
fn is_too_large(error: &anyhow::Error) -> bool {
    matches!(
        error.downcast_ref(),
        Some(ModelError::Device(
            GpuError::TooLarge { .. } | GpuError::OutOfMemory(_)
        ))
    )
}

/// Takes that many steps on views by turns and waits for them.
fn steps(model: &mut GpuModel, views: &[KeyframeId], number: usize) -> Result<(), ModelError> {
    for id in views.iter().cycle().take(number) {
        model.step(*id)?;
    }
    model.finish_steps()
}

/// The phases of a keyframe's insertion, and a pruning, each with its milliseconds in each run.
fn time_keyframe(model: &mut GpuModel, scene: &Scene) -> anyhow::Result<Vec<Stage>> {
    let new = scene.gaussians.len().div_ceil(NEW_SHARE);
    let mut gaussians = scene.gaussians.clone();
    let mut keep = vec![true; new];
    keep.resize(gaussians.len(), false);
    gaussians.retain(&keep);
    let seeds = Seeds {
        sparse_ids: vec![None; new],
        gaussians,
    };
    let id = KeyframeId(VIEWS);
    let rule = PruneRule {
        min_opacity: 0.0,
        max_scale_m: f32::INFINITY,
        max_aspect: f32::INFINITY,
    };
    type Phase<'a> = &'a mut dyn FnMut(&mut GpuModel) -> Result<(), ModelError>;
    let mut stages = Vec::new();
    for _ in 0..RUNS {
        let phases: [(&'static str, Phase<'_>); 5] = [
            ("keyframe: see through", &mut |model| {
                model.see_through(&scene.view, 0.98).map(|_| ())
            }),
            ("keyframe: insert 1 %", &mut |model| {
                model.insert(&seeds, id)
            }),
            ("keyframe: add view", &mut |model| {
                model.add_view(id, scene.view, scene.target.clone())
            }),
            ("keyframe: covisibility", &mut |model| {
                model.covisibility(id).map(|_| ())
            }),
            ("prune nothing", &mut |model| {
                model.prune(&rule)?;
                model.finish_steps()
            }),
        ];
        for (name, phase) in phases {
            let start = Instant::now();
            phase(model)?;
            add_time(&mut stages, name, 1e3 * start.elapsed().as_secs_f64());
        }
        model.drop_view(id)?;
    }
    Ok(stages)
}

fn add_time(stages: &mut Vec<Stage>, name: &'static str, ms: f64) {
    match stages.iter_mut().find(|(known, _)| *known == name) {
        Some((_, times)) => times.push(ms),
        None => stages.push((name, vec![ms])),
    }
}

/// A stage's name and its milliseconds in each run.
type Stage = (&'static str, Vec<f64>);

/// All stages in their order, those of one name added up.
fn by_stage(runs: &[TimedStep]) -> Vec<Stage> {
    let mut stages: Vec<Stage> = Vec::new();
    for (run, step) in runs.iter().enumerate() {
        for &(name, ms) in &step.stages {
            let known = stages.iter().position(|(known, _)| *known == name);
            let place = known.unwrap_or(stages.len());
            if known.is_none() {
                stages.push((name, vec![0.0; runs.len()]));
            }
            stages[place].1[run] += ms;
        }
    }
    stages
}
