//! Whole runs on a graphics device, beside the CPU's. Skipped, and said so, where there is none.

#![allow(clippy::unwrap_used)]

mod common;

use std::io::Write;
use std::sync::atomic::AtomicBool;

use common::saved::Folder;
use common::{
    config, cpu_model, feed, frames, poses, psnr_of_map_db, room, session_with,
    worst_position_error_m,
};
use fgs_slam::{Execution, Slam, SlamOutput, model_settings};
use fgs_splat::{GaussianModel, GpuDevice, GpuError, GpuModel};
use fgs_synth::Sequence;

const FRAMES: usize = 12;
const REFINE_STEPS: usize = 10;

fn go(sequence: &Sequence, execution: Execution, model: Box<dyn GaussianModel>) -> SlamOutput {
    let mut slam = session_with(sequence, execution, model);
    feed(&mut slam, execution, frames(sequence));
    slam.finish_refined(REFINE_STEPS, &AtomicBool::new(false))
}

fn device() -> Option<GpuDevice> {
    match GpuDevice::find(true, None) {
        Ok(device) => Some(device),
        Err(GpuError::NoAdapter(_)) => {
            // Not through `eprintln`, which the test harness keeps to itself.
            let _ = writeln!(
                std::io::stderr(),
                "no graphics device was found: 1 test skipped"
            );
            None
        }
        Err(error) => panic!("{error}"),
    }
}

#[test]
fn a_saved_run_goes_on_to_the_last_bit_on_a_device_and_elsewhere() {
    let Some(device) = device() else { return };
    let sequence = room(FRAMES);
    let mut config = config();
    config.mapping.prune_every = 5;
    let settings = model_settings(&config.mapping);
    let new_model = || Box::new(GpuModel::new(device.clone(), &settings).unwrap());
    let start = || {
        let lockstep = Execution::Lockstep;
        let mut slam = Slam::new(sequence.camera(), &config, lockstep, new_model()).unwrap();
        slam.keep_new_keyframes();
        slam
    };
    let go_on = |mut slam: Slam, indices: std::ops::Range<usize>| {
        for i in indices {
            slam.push(sequence.frame(i)).unwrap();
        }
        slam
    };
    let whole = go_on(start(), 0..FRAMES).finish();
    let mut folder = Folder::default();
    for after in [5, FRAMES - 1] {
        folder.save(&mut go_on(start(), 0..after));
        let restored = |model: Box<dyn GaussianModel>| {
            let slam = folder.restored(&config, Execution::Lockstep, model, folder.saved());
            go_on(slam, after..FRAMES).finish()
        };
        let again = restored(new_model());
        assert_eq!(poses(&again), poses(&whole));
        assert!(again.gaussians == whole.gaussians);
        let on_cpu = restored(cpu_model());
        assert!(on_cpu.failure.is_none());
        assert!(worst_position_error_m(&on_cpu, &sequence) <= 0.01);
    }
}

#[test]
fn a_run_on_a_device_repeats_itself_and_is_as_good_as_on_the_cpu() {
    let Some(device) = device() else { return };
    let sequence = room(FRAMES);
    let settings = model_settings(&config().mapping);
    let new_model = || Box::new(GpuModel::new(device.clone(), &settings).unwrap());
    let on_cpu = go(&sequence, Execution::Lockstep, cpu_model());
    let on_gpu = go(&sequence, Execution::Lockstep, new_model());
    assert!(on_gpu.failure.is_none());
    assert_eq!(on_gpu.timings.steps, on_cpu.timings.steps);
    assert!(on_gpu.device_bytes > 0 && on_cpu.device_bytes == 0);

    let again = go(&sequence, Execution::Lockstep, new_model());
    assert!(again.gaussians == on_gpu.gaussians);
    let refined = |output: &SlamOutput| output.refined.clone().unwrap();
    assert_eq!(refined(&on_gpu).steps, REFINE_STEPS);
    assert!(refined(&again).gaussians == refined(&on_gpu).gaussians);
    assert_eq!(poses(&again), poses(&on_gpu));

    let error_m = |output| worst_position_error_m(output, &sequence);
    let (cpu_error_m, gpu_error_m) = (error_m(&on_cpu), error_m(&on_gpu));
    let slack_m = (0.1 * cpu_error_m).max(1e-4);
    assert!(
        gpu_error_m <= cpu_error_m + slack_m,
        "{gpu_error_m} m, {cpu_error_m} m"
    );
    for index in [0, FRAMES / 2, FRAMES - 1] {
        let psnrs_db = |output: &SlamOutput| {
            let maps = [&output.gaussians, &refined(output).gaussians];
            maps.map(|map| psnr_of_map_db(output, map, &sequence, index))
        };
        let (on_cpu, on_gpu) = (psnrs_db(&on_cpu), psnrs_db(&on_gpu));
        for (on_cpu, on_gpu) in on_cpu.iter().zip(on_gpu) {
            assert!(
                (on_gpu - on_cpu).abs() <= 0.05,
                "frame {index}: {on_gpu} dB, {on_cpu} dB"
            );
        }
    }

    let in_parallel = go(&sequence, Execution::Parallel, new_model());
    assert!(in_parallel.failure.is_none());
    assert!(error_m(&in_parallel) <= cpu_error_m + 1e-3);
}
