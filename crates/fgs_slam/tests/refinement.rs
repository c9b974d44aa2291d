//! Refinement after the last frame: what it gains, that it repeats itself, and that it ends.

#![allow(clippy::unwrap_used)]

mod common;

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use common::{feed, frames, go, poses, psnr_of_map_db, room, session};
use fgs_slam::{Execution, Slam, SlamEvent, SlamOutput, model_settings};
use fgs_splat::CpuModel;
use fgs_synth::Sequence;

const FRAMES: usize = 20;
const STEPS: usize = 60;

fn refine(sequence: &Sequence, execution: Execution, steps: usize) -> SlamOutput {
    let mut slam = session(sequence, execution);
    feed(&mut slam, execution, frames(sequence));
    slam.finish_refined(steps, &AtomicBool::new(false))
}

#[test]
fn a_refined_map_is_better_and_the_recorded_one_is_as_without() {
    let sequence = room(FRAMES);
    for execution in [Execution::Lockstep, Execution::Parallel] {
        let output = refine(&sequence, execution, STEPS);
        let refined = output.refined.as_ref().unwrap();
        assert_eq!((refined.steps, output.timings.steps), (STEPS, 2 * FRAMES));
        for index in [0, FRAMES / 2, FRAMES - 1] {
            let psnr_db = |map| psnr_of_map_db(&output, map, &sequence, index);
            let (before, after) = (psnr_db(&output.gaussians), psnr_db(&refined.gaussians));
            assert!(
                after >= before + 0.5,
                "{execution:?}, frame {index}: {before} dB, then {after} dB"
            );
        }
        if execution == Execution::Lockstep {
            let plain = go(frames(&sequence), &sequence, execution);
            assert!(plain.refined.is_none());
            assert!(plain.gaussians == output.gaussians);
            assert_eq!(poses(&plain), poses(&output));
        }
    }
}

#[test]
fn refinement_repeats_itself_on_any_number_of_threads() {
    let sequence = room(8);
    let refine_on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        let pool = pool.build().unwrap();
        pool.install(|| refine(&sequence, Execution::Lockstep, 12))
    };
    let (one, two) = (refine_on(1), refine_on(2));
    assert!(one.refined.unwrap().gaussians == two.refined.unwrap().gaussians);
}

/// Pruning goes on at its pace: it is due where the steps of recording and refinement make it so.
#[test]
fn steps_of_refinement_count_for_pruning() {
    let sequence = room(4);
    let steps = 10;
    let go = |prune_every| {
        let mut config = common::config();
        config.mapping.prune_every = prune_every;
        // Large steps, so that some gaussians soon are of no use.
        config.mapping.learning_rates.log_scales *= 20.0;
        let model = Box::new(CpuModel::new(model_settings(&config.mapping)));
        let execution = Execution::Lockstep;
        let mut slam = Slam::new(sequence.camera(), &config, execution, model).unwrap();
        feed(&mut slam, execution, frames(&sequence));
        slam.finish_refined(steps, &AtomicBool::new(false))
    };
    let (due, not_due) = (go(2 * 4 + steps), go(2 * 4 + steps + 1));
    assert!(due.gaussians == not_due.gaussians);
    let len = |output: SlamOutput| output.refined.unwrap().gaussians.len();
    assert!(len(due) < len(not_due));
}

#[test]
fn a_stop_ends_refinement_and_what_there_is_is_kept() {
    let sequence = room(6);
    for execution in Execution::ALL {
        let mut slam = session(&sequence, execution);
        let looker_on = slam.subscribe(1000);
        feed(&mut slam, execution, frames(&sequence));
        let stop = AtomicBool::new(false);
        let output = thread::scope(|scope| {
            let refining = scope.spawn(|| slam.finish_refined(usize::MAX, &stop));
            for event in looker_on.events() {
                if let SlamEvent::Refined { done: 3, steps } = event {
                    assert_eq!(steps, usize::MAX);
                    stop.store(true, Ordering::Relaxed);
                }
            }
            refining.join().unwrap()
        });
        let refined = output.refined.unwrap();
        assert!((3..1000).contains(&refined.steps), "{execution:?}");
        assert!(refined.gaussians.len() > 100 && output.gaussians.len() > 100);
        assert!(refined.gaussians != output.gaussians);
    }
}

#[test]
fn without_a_map_or_once_stopped_nothing_is_refined() {
    let sequence = room(3);
    let slam = session(&sequence, Execution::Lockstep);
    let empty = slam.finish_refined(5, &AtomicBool::new(false));
    assert!(empty.refined.is_none() && empty.gaussians.is_empty());
    let mut slam = session(&sequence, Execution::Lockstep);
    feed(&mut slam, Execution::Lockstep, frames(&sequence));
    let stopped = slam.finish_refined(5, &AtomicBool::new(true));
    assert!(stopped.refined.is_none() && stopped.gaussians.len() > 100);
}
