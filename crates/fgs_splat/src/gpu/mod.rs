//! The model on a graphics device, through wgpu: Vulkan, Metal or DirectX 12, with nothing but the
//! driver. The CPU is its reference, stage by stage.
//!
//! `device` finds a device and compiles the `stage`s from `shaders/`, one file for each, named after
//! its twin on the CPU; `layout` is what Rust and shaders share. `buffers` is the memory, and
//! `recorder` and `passes` put the stages of a step in their order. Above them `device_map` holds
//! the gaussians, `training_views` the views, `work_queue` what was asked of the device and not yet
//! heard of, and `gpu_model` makes a [`GaussianModel`](crate::GaussianModel) of the three.
//!
//! Invariants: nothing is read back within a step; no sum has an order that depends on a race, so
//! that results on one device are always the same bits.

mod buffers;
mod device;
mod device_map;
mod gpu_model;
mod images;
mod layout;
mod parameters;
mod passes;
mod pipeline_cache;
mod rates;
mod readback;
mod recorder;
mod resident_targets;
mod scan_check;
mod stage;
mod taps;
#[cfg(test)]
pub mod tests;
mod timer;
mod training_views;
mod work_queue;

pub use device::GpuDevice;
pub use gpu_model::{GpuModel, TimedStep};
pub use rates::{DispatchCosts, Rates};
