//! Sequences on which tracking is likely to fail, with exact truth. They tell whether a tracker knows
//! when it is wrong.

mod errors;
mod motion;
mod passer_by;
mod plain;
mod sight;
mod stage;

use std::ops::Range;
use std::sync::Arc;

use fgs_geom::{Camera, FrameIndex, Image, RgbdFrame, Se3};

use crate::render::Picture;
use crate::sensor::SensorModel;
use crate::sequence::FRAMES_PER_SECOND;
pub use errors::PoseError;
use stage::Stage;

/// Of noise.
const SEED: u64 = 3;

/// What makes the frames of a scenario.
type Director = fn(&mut Scenario);

/// By name.
const DIRECTORS: [(&str, Director); 19] = [
    ("bare-wall", plain::bare_wall),
    ("corridor", plain::corridor),
    ("other-room", motion::other_room),
    ("look-alike", motion::look_alike),
    ("shake", motion::shake),
    ("black", sight::black),
    ("covered", sight::covered),
    ("known-place", motion::known_place),
    ("unknown-place", motion::unknown_place),
    ("meeting", motion::meeting),
    ("exposure", sight::exposure),
    ("passer-by", passer_by::passer_by),
    ("visitor", passer_by::visitor),
    ("host", passer_by::host),
    ("slow-host", passer_by::slow_host),
    ("5-hz", motion::five_hz),
    ("twice", motion::twice),
    ("repeated", motion::repeated),
    ("normal", motion::normal),
];

/// A camera, with a Kinect's noise and motion blur, to which something happens.
pub struct Scenario {
    camera: Camera,
    sensor: SensorModel,
    shots: Vec<Shot>,
    disturbed: Range<usize>,
}

/// How one frame is taken.
#[derive(Clone)]
struct Shot {
    stage: Arc<Stage>,
    /// Where on the stage's path.
    at: f64,
    /// When, in frames of [`FRAMES_PER_SECOND`].
    time: f64,
    /// Shots of one exposure are one image.
    exposure: usize,
    lens: Lens,
    /// Of colour: values above the largest are cut off.
    gain: f32,
}

/// What is before the lens.
#[derive(Clone, Copy, PartialEq)]
enum Lens {
    Free,
    /// Neither sensor gives anything.
    Off,
    /// Something near covers both.
    Covered,
}

impl Scenario {
    /// The names of all scenarios.
    pub fn names() -> impl Iterator<Item = &'static str> {
        DIRECTORS.iter().map(|(name, _)| *name)
    }

    /// The scenario of a name, if there is one, seen by a camera.
    pub fn named(name: &str, camera: Camera) -> Option<Self> {
        let (_, direct) = DIRECTORS.iter().find(|(known, _)| *known == name)?;
        let mut scenario = Self::empty(camera);
        direct(&mut scenario);
        Some(scenario)
    }

    /// As "look-alike", in the rooms of a seed.
    pub fn look_alike(seed: u64, camera: Camera) -> Self {
        let mut scenario = Self::empty(camera);
        motion::look_alike_of(seed, &mut scenario);
        scenario
    }

    fn empty(camera: Camera) -> Self {
        Self {
            camera,
            sensor: SensorModel::kinect(),
            shots: Vec::new(),
            disturbed: 0..0,
        }
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.shots.len()
    }

    /// Whether there are no frames.
    pub fn is_empty(&self) -> bool {
        self.shots.is_empty()
    }

    /// The camera of every frame.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The frames to which it happens. Before them all is well; after them the camera sees what it saw
    /// before.
    pub fn disturbed(&self) -> Range<usize> {
        self.disturbed.clone()
    }

    /// The true pose of a frame, metres. Rooms that are not the first lie far away from it.
    pub fn world_from_camera(&self, index: usize) -> Se3 {
        let shot = &self.shots[index];
        shot.stage.world_from_camera(shot.at)
    }

    /// Renders a frame, on all of rayon's threads.
    pub fn frame(&self, index: usize) -> RgbdFrame {
        let shot = &self.shots[index];
        let picture = match shot.lens {
            Lens::Free => (shot.stage).picture(&self.camera, shot.at, self.sensor.shutter),
            Lens::Off => Picture::black(&self.camera),
            Lens::Covered => covered(&self.camera),
        };
        let color = match shot.lens {
            Lens::Off => Image::filled(self.camera.width, self.camera.height, [0; 3]),
            _ => (self.sensor).develop(&picture.radiance, SEED, shot.exposure),
        };
        RgbdFrame::new(
            FrameIndex(index),
            shot.time / FRAMES_PER_SECOND,
            color.map(|pixel| pixel.map(|value| (f32::from(value) * shot.gain).round() as u8)),
            (self.sensor).measure(&picture.depth_m, &self.camera, SEED, shot.exposure),
            self.camera,
        )
        .unwrap_or_else(|error| unreachable!("no sensor measures this: {error}"))
    }

    /// All frames in order.
    pub fn frames(&self) -> impl ExactSizeIterator<Item = RgbdFrame> + '_ {
        (0..self.len()).map(|index| self.frame(index))
    }

    /// Films a stage from these points of its path, a frame each.
    fn film(&mut self, stage: &Arc<Stage>, path: impl IntoIterator<Item = f64>) {
        for at in path {
            let time = self.shots.last().map_or(0.0, |last| last.time + 1.0);
            self.shots.push(Shot {
                stage: Arc::clone(stage),
                at,
                time,
                exposure: time as usize,
                lens: Lens::Free,
                gain: 1.0,
            });
        }
    }

    /// As [`film`](Self::film), and it is what the scenario is about.
    fn disturb(&mut self, stage: &Arc<Stage>, path: impl IntoIterator<Item = f64>) {
        let start = self.len();
        self.film(stage, path);
        self.disturbed = start..self.len();
    }
}

/// A hand before both sensors: dark, and its depth that of a slanted surface half a metre away.
fn covered(camera: &Camera) -> Picture {
    let mut picture = Picture::black(camera);
    let (width, height) = (camera.width, camera.height);
    picture.depth_m = Image::from_fn(width, height, |u, v| {
        (0.45 + 0.05 * u as f64 / width as f64 + 0.03 * v as f64 / height as f64) as f32
    });
    picture
}

/// A stretch of a path, a point a frame.
fn stretch(from: f64, to: f64, frames: usize) -> impl Iterator<Item = f64> {
    (0..frames).map(move |i| from + (to - from) * i as f64 / frames as f64)
}
