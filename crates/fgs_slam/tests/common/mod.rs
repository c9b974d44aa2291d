//! A synthetic room for whole runs, and how well they did.

#![allow(clippy::unwrap_used, dead_code)]

pub mod saved;
pub mod scenario;

use std::sync::atomic::AtomicBool;

use fgs_geom::{Camera, Image, RgbdFrame, Se3, View};
use fgs_slam::{
    Execution, FrameStatus, Slam, SlamConfig, SlamOutput, drive, model_settings, replay,
};
use fgs_splat::{CpuModel, GaussianModel, Gaussians, Rasterizer};
use fgs_synth::{SensorModel, Sequence, kinect_camera};

pub type Frames = Vec<Result<RgbdFrame, std::io::Error>>;

pub fn room(frames: usize) -> Sequence {
    let camera = kinect_camera(160, 120).unwrap();
    Sequence::new(3, frames, camera, SensorModel::exact())
}

pub fn config() -> SlamConfig {
    let mut config = SlamConfig::default();
    config.mapping.iterations_per_frame = 2.0;
    config
}

pub fn frames(sequence: &Sequence) -> Frames {
    sequence.frames().map(Ok).collect()
}

pub fn cpu_model() -> Box<CpuModel> {
    Box::new(CpuModel::new(model_settings(&config().mapping)))
}

pub fn session(sequence: &Sequence, execution: Execution) -> Slam {
    session_with(sequence, execution, cpu_model())
}

pub fn session_with(
    sequence: &Sequence,
    execution: Execution,
    model: Box<dyn GaussianModel>,
) -> Slam {
    Slam::new(sequence.camera(), &config(), execution, model).unwrap()
}

/// Feeds a session as `fgs run` does.
pub fn feed(
    slam: &mut Slam,
    execution: Execution,
    frames: impl IntoIterator<Item = Result<RgbdFrame, std::io::Error>>,
) {
    let (frames, stop) = (frames.into_iter(), AtomicBool::new(false));
    match execution {
        Execution::Realtime => replay(slam, frames, &stop),
        _ => drive(slam, frames, &stop),
    }
}

pub fn go(frames: Frames, sequence: &Sequence, execution: Execution) -> SlamOutput {
    let mut slam = session(sequence, execution);
    feed(&mut slam, execution, frames);
    slam.finish()
}

/// A letter for each frame: Tracked, Lost, daMaged, Dropped.
pub fn statuses(output: &SlamOutput) -> String {
    let letter = |status| match status {
        FrameStatus::Tracked => 'T',
        FrameStatus::Weak => 'W',
        FrameStatus::Lost => 'L',
        FrameStatus::Damaged => 'M',
        FrameStatus::Dropped => 'D',
        _ => '?',
    };
    let frames = output.frames.iter();
    frames.map(|frame| letter(frame.status)).collect()
}

pub fn count(output: &SlamOutput, status: FrameStatus) -> usize {
    let frames = output.frames.iter();
    frames.filter(|frame| frame.status == status).count()
}

pub fn poses(output: &SlamOutput) -> Vec<Option<Se3>> {
    let frames = output.frames.iter();
    frames.map(|frame| frame.world_from_camera).collect()
}

/// The largest distance between estimated and true camera positions, both seen from the first.
pub fn worst_position_error_m(output: &SlamOutput, sequence: &Sequence) -> f64 {
    let first_from_world = sequence.world_from_camera(0).inverse();
    let errors = output.frames.iter().map(|frame| {
        let truth = first_from_world * sequence.world_from_camera(frame.index.0);
        let estimate = frame.world_from_camera.unwrap_or(Se3::identity());
        (estimate.translation - truth.translation).norm()
    });
    errors.fold(0.0, f64::max)
}

/// The map's colours from a pose.
pub fn picture(
    gaussians: &Gaussians,
    sequence: &Sequence,
    world_from_camera: Se3,
) -> Image<[f32; 3]> {
    picture_at(gaussians, sequence.camera(), world_from_camera)
}

/// The same for any camera.
pub fn picture_at(
    gaussians: &Gaussians,
    camera: &Camera,
    world_from_camera: Se3,
) -> Image<[f32; 3]> {
    let view = View {
        camera: *camera,
        world_from_camera,
    };
    let mut rasterizer = Rasterizer::default();
    rasterizer.render(gaussians, &view).rendered().color.clone()
}

/// How well a map shows a tracked frame, seen from the frame's estimated pose.
pub fn psnr_of_map_db(
    output: &SlamOutput,
    gaussians: &Gaussians,
    sequence: &Sequence,
    index: usize,
) -> f64 {
    let pose = output.frames[index].world_from_camera.unwrap();
    let render = picture(gaussians, sequence, pose);
    psnr_db(&render, &sequence.frame(index).color)
}

fn psnr_db(render: &Image<[f32; 3]>, seen: &Image<[u8; 3]>) -> f64 {
    let pairs = render
        .data()
        .as_flattened()
        .iter()
        .zip(seen.data().as_flattened());
    let squares = pairs.map(|(a, b)| (f64::from(*a) - f64::from(*b) / 255.0).powi(2));
    let count = 3 * render.data().len();
    -10.0 * (squares.sum::<f64>() / count as f64).log10()
}
