//! `fgs`: RGB-D SLAM with gaussian splatting, guided by a Fourier segmentation. Arguments and output
//! only; the work is done by the libraries. Each subcommand has a file of its own.

mod bench;
mod camera;
mod choices;
mod compare;
mod console;
mod demo;
mod doctor;
mod eval;
mod export;
mod failure;
mod fly_through;
mod image_size;
mod import;
mod interrupt;
mod live;
mod memory;
mod merge;
mod progress;
mod render;
#[cfg(feature = "rerun")]
mod rerun;
mod run;
mod synth;
mod threads;
mod view;
mod vulkan_layer;

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use fgs_geom::Instructions;

/// RGB-D SLAM: turns a recording of colour and depth into the camera's trajectory and a map of gaussians.
#[derive(Parser)]
#[command(
    version,
    about,
    after_help = "\
Start here:
  fgs demo                        no data needed; a few minutes
  fgs run recordings/desk --eval  your own recording; `fgs run --help` says how it is laid out"
)]
struct Cli {
    /// Compute with this instruction set, not the widest: to measure what others are worth
    #[arg(
        long,
        global = true,
        hide = true,
        value_name = "avx512|avx2|neon|plain"
    )]
    instructions: Option<Instructions>,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Doctor(doctor::DoctorArgs),
    Run(run::RunArgs),
    Eval(eval::EvalArgs),
    Compare(compare::CompareArgs),
    Merge(merge::MergeArgs),
    Render(render::RenderArgs),
    View(view::ViewArgs),
    Export(export::ExportArgs),
    Import(import::ImportArgs),
    Synth(synth::SynthArgs),
    Demo(demo::DemoArgs),
    Bench(bench::BenchArgs),
}

fn main() -> ExitCode {
    memory::keep_large_arrays_apart();
    vulkan_layer::leave_out_without_desktop();
    let cli = Cli::parse();
    if let Some(Err(error)) = cli.instructions.map(Instructions::choose) {
        console::complain(format_args!("error: {error}"));
        return failure::EXIT_USAGE.into();
    }
    let outcome = match cli.command {
        Command::Doctor(args) => doctor::run(&args),
        Command::Run(args) => run::run(&args),
        Command::Eval(args) => eval::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Merge(args) => merge::run(&args),
        Command::Render(args) => render::run(&args),
        Command::View(args) => view::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Import(args) => import::run(&args),
        Command::Synth(args) => synth::run(&args),
        Command::Demo(args) => demo::run(&args),
        Command::Bench(args) => bench::run(&args),
    };
    match outcome {
        Ok(exit_code) => exit_code.into(),
        Err(error) => {
            console::complain(format_args!("error: {}", failure::message(&error)));
            failure::exit_code(&error).into()
        }
    }
}
