//! The model on a graphics device, through wgpu: Vulkan, Metal or DirectX 12, with nothing but the
//! driver. The CPU is its reference, stage by stage.
//!
//! `device` finds a device and compiles the `stage`s from `shaders/`, one file for each, named as
//! its twin on the CPU; `layout` is what Rust and shaders share. `buffers` are the memory,
//! `recorder` and `passes` put the stages of a step in their order, and `gpu_model` is the
//! [`GaussianModel`](crate::GaussianModel), with `steps` and `whole_map`.
//!
//! Invariants: nothing is read back within a step; no sum has an order that depends on a race, so
//! that results on one device are always the same bits.

mod buffers;
mod device;
mod error;
mod gpu_model;
mod layout;
mod parameters;
mod passes;
mod pipeline_cache;
mod rates;
mod readback;
mod recorder;
mod scan_check;
mod stage;
mod steps;
mod taps;
mod targets;
#[cfg(test)]
pub mod tests;
mod timer;
mod whole_map;

pub use device::GpuDevice;
pub use error::GpuError;
pub use gpu_model::GpuModel;
pub use rates::Rates;
pub use steps::TimedStep;
