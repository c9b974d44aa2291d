//! Measures what the camera file of a recording leaves open.

use std::ops::Range;

use fgs_data::{Dataset, SensorTimes};

use crate::{MeasuredTime, MeasuredTimes, SensorWatch, frames_in, stretches};

/// Most frames that are read: they take one core about 5 s at 640x480, and tell the times to a
/// millisecond if the camera moves at all.
const MAX_FRAMES: usize = 300;

/// How many frames of a recording are read.
pub fn frames_to_measure(dataset: &Dataset) -> usize {
    frames_in(&frames(dataset))
}

/// The times that the camera file gives, and where it gives none, those that the recording shows: 0
/// where it shows nothing for certain. `progress` is called after every frame; if it returns false,
/// the camera file's times are returned.
pub fn measure(dataset: &Dataset, mut progress: impl FnMut() -> bool) -> SensorTimes {
    let given = dataset.camera_file().sensor_times();
    if given.are_known() {
        return given;
    }
    let stretches = frames(dataset);
    let mut watch = SensorWatch::new(*dataset.camera(), frames_in(&stretches));
    for stretch in stretches {
        watch.interrupt();
        for frame in dataset.frames(stretch) {
            match frame {
                Ok(frame) => watch.add(&frame),
                Err(_) => watch.interrupt(),
            }
            if !progress() {
                return given;
            }
        }
    }
    let measured = MeasuredTimes::of(watch, dataset.camera_file());
    let known_or = |given: Option<f64>, measured: Option<MeasuredTime>| {
        Some(given.unwrap_or_else(|| measured.map_or(0.0, |time| time.or_zero())))
    };
    SensorTimes {
        depth_delay_secs: known_or(given.depth_delay_secs, measured.depth_delay),
        color_readout_secs: known_or(given.color_readout_secs, measured.color_readout),
        depth_readout_secs: known_or(given.depth_readout_secs, measured.depth_readout),
    }
}

fn frames(dataset: &Dataset) -> Vec<Range<usize>> {
    let times: Vec<f64> = dataset.timestamps().collect();
    stretches(&times, MAX_FRAMES)
}
