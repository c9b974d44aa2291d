//! What a source is aligned to.

mod cell;
mod cell_grid;
mod nearest_two;
mod point_map;

pub(crate) use point_map::LastingNearest;
pub use point_map::{Neighbor, PointMap};
