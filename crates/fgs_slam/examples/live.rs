//! SLAM beside a live camera. Replace `camera_frames` by your own: anything that blocks until the
//! next frame comes and ends with `None`.
//!
//!     cargo run --release -p fgs_slam --example live

#![allow(clippy::print_stdout, reason = "an example prints")]

use std::error::Error;
use std::sync::atomic::AtomicBool;
use std::thread;

use fgs_slam::{Execution, Slam, SlamConfig, SlamEvent, live, model_settings};
use fgs_splat::CpuModel;

fn main() -> Result<(), Box<dyn Error>> {
    let (camera, source) = camera_frames()?;
    let config = SlamConfig::default();
    let model = CpuModel::new(model_settings(&config.mapping));
    let mut slam = Slam::new(&camera, &config, Execution::Realtime, Box::new(model))?;
    let looker_on = slam.subscribe(100);
    let printing = thread::spawn(move || {
        for event in looker_on.events() {
            if let SlamEvent::Frame {
                result,
                num_gaussians,
                ..
            } = event
            {
                let position = result.world_from_camera.map(|pose| pose.translation);
                println!(
                    "{} {} {position:.3?} {num_gaussians}",
                    result.index.0, result.status
                );
            }
        }
    });
    let stop = AtomicBool::new(false); // set it from anywhere to end the session
    live(&mut slam, source, &stop)?;
    let output = slam.finish();
    printing
        .join()
        .map_err(|_| "the printing thread panicked")?;
    println!(
        "{} gaussians from {} keyframes",
        output.gaussians.len(),
        output.keyframes.len()
    );
    output.failure.map_or(Ok(()), |failure| Err(failure.into()))
}

/// A stand-in for a camera's driver: two seconds of a synthetic room at 30 frames a second.
#[allow(clippy::type_complexity)]
fn camera_frames() -> Result<
    (
        fgs_geom::Camera,
        impl FnMut() -> Option<Result<fgs_geom::RgbdFrame, std::io::Error>>,
    ),
    Box<dyn Error>,
> {
    let camera = fgs_synth::kinect_camera(160, 120)?;
    let room = fgs_synth::Sequence::new(3, 60, camera, fgs_synth::SensorModel::exact());
    let mut next = 0;
    let source = move || {
        thread::sleep(std::time::Duration::from_millis(33));
        next += 1;
        (next <= room.len()).then(|| Ok(room.frame(next - 1)))
    };
    Ok((camera, source))
}

#[test]
fn runs() {
    main().map_err(|error| error.to_string()).unwrap();
}
