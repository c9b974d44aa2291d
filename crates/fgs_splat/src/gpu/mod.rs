//! The model on a graphics device through wgpu: Vulkan, Metal or DirectX 12, with no dependency but
//! the driver. The CPU rasteriser is its reference, stage by stage.
//!
//! `device` opens a device and compiles the `stage`s, the compute pipelines of `shaders/`, named
//! after their CPU counterparts; `layout` defines what Rust and shaders share. `buffers` owns the
//! device memory; `recorder` and `passes` record a step's dispatches. On top of these `device_map`
//! holds the gaussians, `training_views` the views and `work_queue` the submissions in flight;
//! `gpu_model` makes a [`GaussianModel`](crate::GaussianModel) of the three.
//!
//! Invariants: nothing is read back within a step; no sum depends on how threads are scheduled, so
//! that results on one device are reproducible to the bit.

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
