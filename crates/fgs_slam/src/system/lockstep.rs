//! Tracker and mapper in strict turns on one thread; inside a turn all threads compute.

use std::error::Error;
use std::sync::atomic::Ordering;

use fgs_geom::RgbdFrame;
use fgs_splat::GaussianModel;

use super::SlamError;
use super::front::{Front, MapSize};
use super::worker::MapperWorker;

pub fn run<E: Error + 'static, M: GaussianModel>(
    frames: impl Iterator<Item = Result<RgbdFrame, E>>,
    front: &mut Front<'_>,
    mut worker: MapperWorker<M>,
) -> Result<MapperWorker<M>, SlamError> {
    let map = MapSize::default();
    let stop = front.stop;
    for frame in frames.take_while(|_| !stop.load(Ordering::Relaxed)) {
        match frame {
            Err(error) => front.skip(&error),
            Ok(frame) => {
                let keyframe = front.track(frame, &map);
                let changes = worker.after_frame(keyframe.as_ref(), &map)?;
                front.tracker.update_map(&changes);
            }
        }
    }
    Ok(worker)
}
