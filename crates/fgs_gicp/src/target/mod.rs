//! The target of a registration: a point map with nearest-neighbour search.

mod cell;
mod cell_grid;
mod nearest_two;
mod point_map;

pub(crate) use point_map::LastingNearest;
pub use point_map::{Neighbor, PointMap};
