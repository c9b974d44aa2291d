//! Runs at work in the [Rerun](https://rerun.io) viewer, or in a file for it.
//!
//! [`RerunView`] is told what there is to see as the live page is ([`fgs_view::watch`]): from a thread and a
//! bounded queue of its own, so that a slow viewer or disk loses events and does not hold the run up.
//!
//! | entity | what | axes |
//! |---|---|---|
//! | `world` | the first camera: x right, y down, z forward, metres | |
//! | `world/camera`, `world/camera/image` | the camera of each frame, its frustum and image | of the camera |
//! | `world/map` | the gaussians | of the world |
//! | `world/keyframes/tracking/N`, `.../mapping/N` | the keyframe that frame N became | of the keyframe |
//! | `world/graph/edges`, `world/graph/loops` | successive keyframes; those that a loop joined | of the world |
//! | `world/trajectory`, `world/reference` | the way of the camera, and the recording's own | of the world |
//! | `pictures/*` | render, depth, the render's depth, and what a keyframe adds to the map | |
//! | `plots/*` | numbers of each frame | |
//! | `log` | verdicts, when they change | |
//!
//! Timelines are `frame`, the frame's number, and `time`, seconds since the first frame on the recording's
//! clock. What grows with the run is written again only when it has grown by a part, so that a file is a few
//! times as large as its end.
//!
//! Without the feature `sdk` this crate is empty.
#![cfg(feature = "sdk")]

mod blueprint;
mod error;
mod growth;
mod recorder;
mod view;

pub use error::RerunError;
pub use view::{Outcome, Outputs, RerunView};
