//! What a source is aligned to.

mod point_map;

pub use point_map::{Neighbor, PointMap};
