//! Times a forward and a backward pass of 100 000 gaussians over a smooth synthetic frame, at
//! 640x480 and 1200x680. Prints the median and the minimum in milliseconds: on 1 thread of the
//! processor time (which a busy machine inflates less), on 2 threads of the wall time.
//!
//! The gaussians sit at random pixels of the frame at its depth; each axis' standard deviation is
//! depth / f times 1 to 2, rotations are random, opacity is 0.99.

use std::time::Instant;

use fgs_geom::{Camera, Image, Intrinsics, Se3, View};
use fgs_splat::{Cotangents, GaussianGradients, Gaussians, Rasterizer, SH0_FACTOR};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

const GAUSSIANS: usize = 100_000;
const RUNS: usize = 11;

fn main() {
    let frames = [
        (640, 480, [525.0, 525.0, 319.5, 239.5]),
        (1200, 680, [600.0, 600.0, 599.5, 339.5]),
    ];
    println!("size threads forward_ms(median min) backward_ms(median min) sum_ms(median min)");
    for (width, height, [fx, fy, cx, cy]) in frames {
        let camera = Camera::new(width, height, Intrinsics { fx, fy, cx, cy }).unwrap();
        let view = View {
            camera,
            world_from_camera: Se3::identity(),
        };
        let gaussians = scene(&camera);
        for threads in [1] {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            let start = Instant::now();
            let wall_ms = || 1e3 * start.elapsed().as_secs_f64();
            let thread_ms = || thread_cpu_ms().unwrap_or_else(wall_ms);
            let times = pool.install(|| match threads {
                1 => measure(&gaussians, &view, thread_ms),
                _ => measure(&gaussians, &view, wall_ms),
            });
            let column = |i: usize| {
                let mut values: Vec<f64> = times.iter().map(|times| times[i]).collect();
                values.sort_by(f64::total_cmp);
                format!("{:.1} {:.1}", values[RUNS / 2], values[0])
            };
            println!(
                "{width}x{height} {threads}  {}  {}  {}",
                column(0),
                column(1),
                column(2)
            );
        }
    }
}

/// Milliseconds of forward, backward and both, of each run.
fn measure(gaussians: &Gaussians, view: &View, now: impl Fn() -> f64) -> Vec<[f64; 3]> {
    let (width, height) = (view.camera.width, view.camera.height);
    let mut rng = Pcg64Mcg::seed_from_u64(2);
    let mut number = || rng.random_range(-1.0..1.0);
    let cotangents = Cotangents {
        d_color: Image::from_fn(width, height, |_, _| [number(), number(), number()]),
        d_depth_m: Image::from_fn(width, height, |_, _| number()),
        d_alpha: Image::from_fn(width, height, |_, _| number()),
    };
    let mut rasterizer = Rasterizer::default();
    let mut gradients = GaussianGradients::default();
    let mut run = || {
        let start = now();
        let mut pass = rasterizer.render(gaussians, view);
        let middle = now();
        pass.vjp(&cotangents, &mut gradients);
        let end = now();
        [middle - start, end - middle, end - start]
    };
    run();
    (0..RUNS).map(|_| run()).collect()
}

/// Processor time of this thread, where the system tells (Linux).
fn thread_cpu_ms() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    let nanoseconds: f64 = text.split_whitespace().next()?.parse().ok()?;
    Some(1e-6 * nanoseconds)
}

fn scene(camera: &Camera) -> Gaussians {
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let mut gaussians = Gaussians::default();
    for _ in 0..GAUSSIANS {
        let u = rng.random_range(0..camera.width) as f64;
        let v = rng.random_range(0..camera.height) as f64;
        let depth = 2.5 + (u / 150.0).sin() + 0.5 * (v / 90.0).cos();
        let mean = camera.unproject(u, v, depth);
        gaussians
            .means
            .push([mean.x, mean.y, mean.z].map(|x| x as f32));
        let quat = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
        gaussians.quats.push(quat);
        let pixel = (depth / camera.intrinsics.fx) as f32;
        let log_scale = std::array::from_fn(|_| (pixel * rng.random_range(1.0..2.0_f32)).ln());
        gaussians.log_scales.push(log_scale);
        gaussians.opacity_logits.push((0.99_f32 / 0.01).ln());
        let sh = std::array::from_fn(|_| (rng.random_range(0.0..1.0) - 0.5) / SH0_FACTOR as f32);
        gaussians.sh.push(sh);
    }
    gaussians
}
