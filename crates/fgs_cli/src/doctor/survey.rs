//! Reads frames for the checks: all frames of a short recording, stretches of a long one.

use std::ops::Range;

use fgs_data::Dataset;
use fgs_geom::{FrameIndex, RgbdFrame};
use fgs_sensors::{SensorWatch, frames_in, stretches};

use super::depth_along_z::FlatnessWatch;
use super::depth_to_color::EdgeMatcher;
use super::exposure::ExposureWatch;
use super::frame_pairs::PairBuilder;
use super::repeated_images::RepeatWatch;
use super::statistics::{depth_share, median_depth};

/// Most frames that are read: they take one core about 10 s at 640x480.
const MAX_FRAMES: usize = 600;

/// Frames whose edges are compared, evenly spread: enough to detect a shift of a pixel.
const EDGE_FRAMES: usize = 24;

/// What was learned from the frames.
pub struct Survey {
    /// Frames that cannot be read, and why.
    pub unreadable: Vec<(FrameIndex, String)>,
    /// Share of pixels with valid depth, for each frame.
    pub depth_shares: Vec<(FrameIndex, f64)>,
    /// Median depth of each frame that has valid depth, metres.
    pub median_depths_m: Vec<f64>,
    /// Brightness from frame to frame.
    pub exposure: ExposureWatch,
    /// Images that come twice.
    pub repeats: RepeatWatch,
    /// How flat flat surfaces are.
    pub flatness: FlatnessWatch,
    /// Agreement of depth with colour edges.
    pub edges: EdgeMatcher,
    /// Registered motions.
    pub pairs: PairBuilder,
    /// Motions of depth sensor and colour camera.
    pub sensors: SensorWatch,
}

impl Survey {
    /// Reads the recording; `progress` is called after every frame.
    pub fn read(dataset: &Dataset, mut progress: impl FnMut()) -> Self {
        let stretches = frames(dataset);
        let len = frames_in(&stretches);
        let mut survey = Self {
            unreadable: Vec::new(),
            depth_shares: Vec::new(),
            median_depths_m: Vec::new(),
            exposure: ExposureWatch::default(),
            repeats: RepeatWatch::default(),
            flatness: FlatnessWatch::default(),
            edges: EdgeMatcher::default(),
            pairs: PairBuilder::new(*dataset.camera()),
            sensors: SensorWatch::new(*dataset.camera(), len),
        };
        let edge_every = len.div_ceil(EDGE_FRAMES);
        for stretch in stretches {
            survey.interrupt();
            for (index, frame) in stretch.clone().zip(dataset.frames(stretch)) {
                progress();
                match frame {
                    Ok(frame) => survey.add(&frame, edge_every),
                    Err(error) => {
                        survey
                            .unreadable
                            .push((FrameIndex(index), error.to_string()));
                        survey.interrupt();
                    }
                }
            }
        }
        survey.interrupt();
        survey
    }

    /// How many frames were tried.
    pub fn frames_read(&self) -> usize {
        self.depth_shares.len() + self.unreadable.len()
    }

    fn add(&mut self, frame: &RgbdFrame, edge_every: usize) {
        if self.depth_shares.len().is_multiple_of(edge_every) {
            self.edges.add(frame);
            self.flatness.add(&frame.depth_m, &frame.camera);
        }
        self.depth_shares
            .push((frame.index, depth_share(&frame.depth_m)));
        self.median_depths_m
            .extend(median_depth(&frame.depth_m).map(f64::from));
        self.exposure.add(frame.index, &frame.color);
        self.repeats.add(frame);
        self.pairs.add(frame);
        self.sensors.add(frame);
    }

    fn interrupt(&mut self) {
        self.exposure.interrupt();
        self.repeats.interrupt();
        self.pairs.interrupt();
        self.sensors.interrupt();
    }
}

/// How many frames of a recording are read.
pub fn frames_to_read(dataset: &Dataset) -> usize {
    frames_in(&frames(dataset))
}

fn frames(dataset: &Dataset) -> Vec<Range<usize>> {
    let times: Vec<f64> = dataset.timestamps().collect();
    stretches(&times, MAX_FRAMES)
}
