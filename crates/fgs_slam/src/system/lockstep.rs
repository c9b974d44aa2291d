//! Tracker and mapper in strict turns on one thread; inside a turn all threads compute.

use std::error::Error;

use fgs_geom::RgbdFrame;
use fgs_splat::GaussianModel;

use super::front::{Front, MapSize};
use super::worker::MapperWorker;

pub fn run<E: Error + 'static, M: GaussianModel>(
    frames: impl Iterator<Item = Result<RgbdFrame, E>>,
    front: &mut Front<'_>,
    mut worker: MapperWorker<M>,
) -> MapperWorker<M> {
    let map = MapSize::default();
    front.follow(frames, |front, frame| {
        let keyframe = front.track(frame, &map);
        let changes = worker.after_frame(keyframe.as_ref(), &map)?;
        front.tracker.update_map(&changes);
        Some(())
    });
    worker
}
