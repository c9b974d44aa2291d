//! What this machine's memory and arithmetic can do.

use std::hint::black_box;
use std::time::Instant;

use fgs_geom::{Kernel, dispatch};
use rayon::prelude::*;
use serde::Serialize;

/// Floats copied at a time: far more than any cache holds.
const COPIED: usize = 1 << 26;
/// Independent sums, enough to hide the latency of a multiply-add on two units.
const CHAINS: usize = 10;
const MULTIPLY_ADDS: usize = 10_000_000;
const RUNS: usize = 5;

/// Best rates of some threads together.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Rates {
    pub threads: usize,
    /// Bytes read plus bytes written.
    pub bytes_per_sec: f64,
    /// On `f32`, a multiply-add counting two.
    pub flops_per_sec: f64,
}

impl Rates {
    pub fn measure(pool: &rayon::ThreadPool) -> Self {
        let threads = pool.current_num_threads();
        let source = vec![1.0_f32; COPIED];
        let mut copy = vec![0.0_f32; COPIED];
        let part = COPIED / threads;
        let copy_secs = best_secs(|| {
            pool.install(|| {
                let parts = copy.par_chunks_mut(part).zip(source.par_chunks(part));
                parts.for_each(|(copy, source)| copy.copy_from_slice(source));
            });
            black_box(&mut copy);
        });
        let mut lanes = 0;
        let flop_secs = best_secs(|| {
            lanes = pool.broadcast(|_| dispatch(MultiplyAdds)).iter().sum();
        });
        Self {
            threads,
            bytes_per_sec: 8.0 * (part * threads) as f64 / copy_secs,
            flops_per_sec: 2.0 * (lanes * CHAINS * MULTIPLY_ADDS) as f64 / flop_secs,
        }
    }

    /// The least time for this much work.
    pub fn floor_ms(&self, bytes: f64, flops: f64) -> f64 {
        1e3 * (bytes / self.bytes_per_sec).max(flops / self.flops_per_sec)
    }
}

fn best_secs(mut run: impl FnMut()) -> f64 {
    let times = (0..RUNS).map(|_| {
        let start = Instant::now();
        run();
        start.elapsed().as_secs_f64()
    });
    times.fold(f64::INFINITY, f64::min)
}

/// Multiply-adds on independent sums; returns how many numbers each holds.
struct MultiplyAdds;

impl Kernel for MultiplyAdds {
    type Output = usize;

    #[inline(always)]
    fn run<const FUSED: bool, const WIDTH: usize>(self) -> usize {
        let (a, b) = (black_box(0.999_f32), black_box(1e-3_f32));
        let mut sums = [[0.0_f32; WIDTH]; CHAINS];
        for _ in 0..MULTIPLY_ADDS {
            for sum in &mut sums {
                for x in sum.iter_mut() {
                    *x = if FUSED { x.mul_add(a, b) } else { *x * a + b };
                }
            }
        }
        black_box(sums);
        WIDTH
    }
}
