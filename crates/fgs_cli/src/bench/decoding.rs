//! Decoding a recorded frame: colour and depth from their files to pixels and metres.

use std::hint::black_box;

use anyhow::ensure;
use fgs_geom::has_depth;

use super::input::Input;
use super::stage::{Bench, Stage};

/// Hands the stage to `bench`. It runs on one thread whatever their number: frames are decoded
/// side by side, not parts of a frame.
pub fn bench(input: &Input, bench: &mut Bench<'_>) -> anyhow::Result<()> {
    let Some(dataset) = &input.dataset else {
        return Ok(());
    };
    let seen = &input.frames[0];
    let (index, camera) = (seen.index.0, seen.camera);
    let pixels = camera.width * camera.height;
    bench(Stage {
        name: "decoding",
        work: format!("{}x{}, colour and depth", camera.width, camera.height),
        // Three bytes of colour and four of depth a pixel.
        bytes: 7.0 * pixels as f64,
        flops: 0.0,
        check: Box::new(move || {
            let frame = dataset.frame(index)?;
            let valid = frame.depth_m.data().iter().filter(|z| has_depth(**z));
            ensure!(
                frame.depth_m.data().len() == pixels,
                "depth has another size"
            );
            ensure!(valid.count() > pixels / 10, "hardly any pixel has depth");
            ensure!(
                frame.color == seen.color,
                "colour differs from the stream's"
            );
            Ok(())
        }),
        run: Box::new(move || {
            black_box(dataset.frame(index).is_ok());
        }),
    })
}
