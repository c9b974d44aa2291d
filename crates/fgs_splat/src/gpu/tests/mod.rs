//! Tests of the shaders alone, of every stage against the CPU, and of the whole model.

mod device;
mod model;
mod repeatability;
mod scenes;
mod shaders;
mod stages;

pub use device::device;
