//! The relative pose of two RGB-D frames without a first guess.
//!
//! [`Features::detect`] finds corners in a frame's colour image, describes what is around them and
//! measures where they are in space; [`match_features`] pairs the corners of two frames that look
//! alike; [`relative_pose`] finds the rigid motion that most pairs agree on. Can be used on its own.
//!
//! What counts is that a pose is found from far away and that a wrong one is practically never
//! given. Registration refines it.
//!
//! Nothing here uses threads: the same input gives the same result, bit for bit.

mod agreement;
mod corners;
mod descriptor;
mod features;
mod matching;
mod pyramid;
mod relative_pose;

pub use descriptor::Descriptor;
pub use features::{Feature, Features};
pub use matching::{Match, match_features};
pub use relative_pose::{RelativePose, relative_pose};
