//! Procedural RGB-D sequences of furnished rooms with ground-truth poses and depth, for tests,
//! demos and benchmarks.
//!
//! ```no_run
//! use fgs_synth::{KINECT, SensorModel, Sequence};
//!
//! let sequence = Sequence::new(7, 300, KINECT, SensorModel::exact());
//! let frame = sequence.frame(0);
//! let world_from_camera = sequence.world_from_camera(0);
//! ```
//!
//! World frame: z up, metres. A frame depends on nothing but the sequence it belongs to (seed,
//! rooms, camera, sensor) and its index, so renders are reproducible.

mod builder;
mod bvh;
mod decor;
mod furniture;
mod layout;
mod light;
mod noise;
mod path;
mod pattern;
mod picture;
mod render;
mod room;
mod round;
mod scenario;
mod sensor;
mod sequence;
mod shape;
mod walk;
mod write;

pub use path::{CameraPath, FRAMES_PER_LOOP};
pub use room::Room;
pub use scenario::{PoseError, Scenario};
pub use sensor::SensorModel;
pub use sequence::{FRAMES_PER_SECOND, KINECT, Sequence, kinect_camera};
pub use write::{SynthError, write_replica, write_tum};
