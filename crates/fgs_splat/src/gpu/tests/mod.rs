//! Tests of the shaders by themselves, then of every stage against the CPU.

mod device;
mod model;
mod repeatability;
mod scenes;
mod shaders;
mod stages;

pub use device::device;
