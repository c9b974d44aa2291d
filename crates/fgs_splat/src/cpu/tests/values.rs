//! Rendered values against the closed form and the reference.

use rand::RngExt;

use super::scenes::{random_gaussians, random_view, rng, to_f32};
use crate::cpu::Rasterizer;
use crate::reference;

/// Sizes of random scenes.
const SIZES: [(usize, usize); 5] = [(1, 1), (17, 33), (33, 17), (16, 16), (40, 25)];

#[test]
fn tiled_agrees_with_the_reference() {
    let (mut compared, mut f32_skipped) = (0, 0);
    let mut brightest = 0.0_f64;
    for seed in 0..200 {
        let mut rng = rng(seed);
        let (width, height) = SIZES[seed as usize % SIZES.len()];
        let view = random_view(&mut rng, width, height);
        let count = rng.random_range(1..60);
        let gaussians = random_gaussians(&mut rng, &view, count);
        let expected = reference::render(&gaussians, &view);
        let mut rasterizer = Rasterizer::default();
        let pass = rasterizer.render(&gaussians, &view);
        let double = pass.rendered();
        let single_gaussians = to_f32(&gaussians);
        let mut single_rasterizer = Rasterizer::default();
        let single_pass = single_rasterizer.render(&single_gaussians, &view);
        let single = single_pass.rendered();
        for (i, expected) in expected.iter().enumerate() {
            let values = [
                expected.color[0],
                expected.color[1],
                expected.color[2],
                expected.depth_m,
                expected.alpha,
            ];
            let [r, g, b] = double.color.data()[i];
            let found = [r, g, b, double.depth_m.data()[i], double.alpha.data()[i]];
            let [r, g, b] = single.color.data()[i];
            let found_single = [r, g, b, single.depth_m.data()[i], single.alpha.data()[i]];
            for ((value, found), single) in values.iter().zip(found).zip(found_single) {
                if expected.margin > 1e-9 {
                    assert!(
                        (value - found).abs() <= 1e-10,
                        "{seed} {i}: {found} instead of {value}"
                    );
                }
                if expected.margin > 1e-3 {
                    let error = (value - f64::from(single)).abs();
                    assert!(
                        error <= 2e-5 * value.abs().max(1.0),
                        "{seed} {i}: {single} instead of {value}"
                    );
                    compared += 1;
                } else {
                    f32_skipped += 1;
                }
                brightest = brightest.max(*value);
            }
        }
    }
    println!("{compared} compared, {f32_skipped} near thresholds");
    assert!(compared > 10 * f32_skipped && brightest > 1.0);
}
