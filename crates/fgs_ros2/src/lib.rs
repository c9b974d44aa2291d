//! Cameras of ROS 2 as live cameras of fgs-slam, without ROS installed: DDS is spoken by RustDDS.
//!
//! [`open`] waits for a camera's topics and gives two things: a [`Ros2Camera`], whose images a run tracks,
//! and a [`Ros2Publisher`], which watches the run and publishes poses, points and the map. Both are parts of
//! one ROS node, `/fgs_slam`.//!
//! Invariant: what comes over the network is untrusted. Messages are read by `fgs_recordings`, as those of
//! bags are; a damaged one is a damaged frame.

#![cfg(feature = "dds")]

mod camera;
mod error;
mod messages;
mod node;
mod pairs;
mod points;
mod publisher;
mod raw_topic;
mod topics;

pub use camera::{Ros2Camera, open};
pub use error::Ros2Error;
pub use messages::{
    CameraInfo, Header, Image, Path, PointCloud2, PoseStamped, RegionOfInterest, Stamp, TfMessage,
    UInt8MultiArray,
};
pub use node::{Domain, Ros2Node};
pub use publisher::Ros2Publisher;
pub use topics::Topics;
