//! Every stage of the system on the CPU, with one thread and with two.

use anyhow::Context;
use fgs_geom::Instructions;
use serde::Serialize;

use super::baseline::StageTime;
use super::input::Input;
use super::machine::Rates;
use super::stage::{Stage, Times};
use super::{decoding, mapping, tracking};
use crate::console::Console;

/// One line of the table.
#[derive(Serialize)]
struct Row<'a> {
    input: &'a str,
    stage: &'a str,
    work: &'a str,
    threads: usize,
    instructions: &'static str,
    median_ms: f64,
    best_ms: f64,
    floor_ms: f64,
}

/// Times all inputs, mapping with each of the numbers of gaussians; returns the times.
///
/// # Errors
/// If a stage gives a wrong result.
pub fn run(
    inputs: &[Input],
    numbers: &[usize],
    console: Console,
) -> anyhow::Result<Vec<StageTime>> {
    let pools = [1, 2].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.with_context(|| format!("cannot start {threads} threads"))
    });
    let instructions = Instructions::in_use();
    console.say(format!("instructions: {instructions}"));
    let mut times = Vec::new();
    let [one, two] = pools;
    let pools = [one?, two?];
    let rates = [Rates::measure(&pools[0]), Rates::measure(&pools[1])];
    for (pool, rates) in pools.iter().zip(&rates) {
        console.say(format!(
            "{} thread(s): {:.1} GB/s, {:.0} GFLOP/s",
            pool.current_num_threads(),
            1e-9 * rates.bytes_per_sec,
            1e-9 * rates.flops_per_sec,
        ));
        console.event("machine", rates);
    }
    console.say(format!(
        "\n{:<10} {:<28} {:<44} threads  median ms    best ms   floor ms",
        "input", "stage", "work"
    ));
    for input in inputs {
        let mut bench = |stage: Stage<'_>| -> anyhow::Result<()> {
            let Stage {
                name,
                work,
                bytes,
                flops,
                mut check,
                mut run,
            } = stage;
            check().with_context(|| format!("{name} on {} is wrong", input.name))?;
            for (pool, rates) in pools.iter().zip(&rates) {
                let Times { median_ms, best_ms } = pool.install(|| Times::measure(&mut *run));
                let row = Row {
                    input: &input.name,
                    stage: name,
                    work: &work,
                    threads: pool.current_num_threads(),
                    instructions: instructions.name(),
                    median_ms,
                    best_ms,
                    floor_ms: rates.floor_ms(bytes, flops),
                };
                console.say(format!(
                    "{:<10} {:<28} {:<44} {:>7} {:>10.3} {:>10.3} {:>10.3}",
                    row.input,
                    row.stage,
                    row.work,
                    row.threads,
                    row.median_ms,
                    row.best_ms,
                    row.floor_ms
                ));
                console.event("stage", &row);
                times.push(StageTime {
                    input: input.name.clone(),
                    stage: name.to_owned(),
                    work: work.clone(),
                    threads: row.threads,
                    best_ms,
                });
            }
            Ok(())
        };
        decoding::bench(input, &mut bench)?;
        tracking::bench(input, console, &mut bench)?;
        for &count in numbers {
            mapping::bench(input, count, &mut bench)?;
        }
    }
    Ok(times)
}
