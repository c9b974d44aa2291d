//! Measures a device's memory bandwidth, arithmetic throughput and dispatch overhead: lower bounds
//! for the stages' times follow from them.
//!
//! Uses the wall clock, since not every device has timestamp queries. Each kernel is repeated within
//! one submission until the submission's own overhead is negligible.

use std::time::Instant;

use super::device::GpuDevice;
use super::layout::{COPIED_ROWS, GROUP, MULTIPLY_ADD_ROUNDS};
use crate::GpuError;

/// Bytes that a workgroup copies.
const COPIED_BYTES: u64 = 16 * (COPIED_ROWS * GROUP) as u64;
/// Bytes per copy, if the device can bind that much; far more than any cache holds.
const COPY_BYTES: u64 = 512 << 20;
/// Workgroups of multiply-adds. Their output fits the smallest buffer that a device must bind.
const MULTIPLY_ADD_GROUPS: u32 = 1 << 13;
/// Dispatches per pass when their overhead is measured.
const DISPATCHES: u32 = 1000;
/// A submission that takes this long is timed accurately.
const LONG_SECS: f64 = 0.25;

/// Measured peak rates of a device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Bytes read plus bytes written.
    pub bytes_per_sec: f64,
    /// `f32` operations; a multiply-add counts as two.
    pub flops_per_sec: f64,
}

/// The overhead of a stage that depends on the previous one: an empty dispatch and a barrier.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DispatchCosts {
    /// Direct dispatch, seconds.
    pub direct_secs: f64,
    /// Indirect dispatch, seconds.
    pub indirect_secs: f64,
}

impl GpuDevice {
    /// Measures the overhead of a stage.
    ///
    /// # Errors
    /// If the device fails or is out of memory.
    pub fn measure_dispatch_costs(&self) -> Result<DispatchCosts, GpuError> {
        let storage = wgpu::BufferUsages::STORAGE;
        let touched = self.buffer("what dispatches touch", 16, storage)?;
        let size = self.buffer(
            "a dispatch's size",
            12,
            storage | wgpu::BufferUsages::INDIRECT,
        )?;
        self.queue()
            .write_buffer(&size, 0, bytemuck::bytes_of(&[1_u32; 3]));
        let stage = self.stage("touch")?;
        let buffers = stage.bind(self.raw(), |_| Ok(&touched))?;
        let secs = |dispatch: &dyn Fn(&mut wgpu::ComputePass<'_>)| {
            let of_many = self.best_secs(|encoder| {
                let mut pass = encoder.begin_compute_pass(&Default::default());
                pass.set_pipeline(&stage.pipeline);
                pass.set_bind_group(0, &buffers, &[]);
                (0..DISPATCHES).for_each(|_| dispatch(&mut pass));
            })?;
            Ok::<_, GpuError>(of_many / f64::from(DISPATCHES))
        };
        Ok(DispatchCosts {
            direct_secs: secs(&|pass| pass.dispatch_workgroups(1, 1, 1))?,
            indirect_secs: secs(&|pass| pass.dispatch_workgroups_indirect(&size, 0))?,
        })
    }

    /// Measures the device's peak rates. Takes a second or two and up to 1 GiB of its memory.
    ///
    /// # Errors
    /// If the device fails or is out of memory.
    pub fn measure_rates(&self) -> Result<Rates, GpuError> {
        let groups = COPY_BYTES.min(self.binding_limit()) / COPIED_BYTES;
        let bytes = groups * COPIED_BYTES;
        let make = |what| self.buffer(what, bytes, wgpu::BufferUsages::STORAGE);
        let (source, copied) = (make("what is copied")?, make("copies")?);

        let by_stage = |name, groups| {
            let stage = self.stage(name)?;
            let buffers = stage.bind(self.raw(), |name| match name {
                "source" => Ok(&source),
                _ => Ok(&copied),
            })?;
            self.best_secs(|encoder| {
                let mut pass = encoder.begin_compute_pass(&Default::default());
                pass.set_pipeline(&stage.pipeline);
                pass.set_bind_group(0, &buffers, &[]);
                pass.dispatch_workgroups(groups, 1, 1);
            })
        };
        // Kernel or copy command: which is faster depends on the driver.
        let copy_secs = by_stage("copy_rows", groups as u32)?.min(self.best_secs(|encoder| {
            encoder.copy_buffer_to_buffer(&source, 0, &copied, 0, bytes);
        })?);
        let multiply_add_secs = by_stage("multiply_add", MULTIPLY_ADD_GROUPS)?;
        let multiply_adds =
            32.0 * f64::from(MULTIPLY_ADD_ROUNDS) * f64::from(MULTIPLY_ADD_GROUPS * GROUP);
        Ok(Rates {
            bytes_per_sec: 2.0 * bytes as f64 / copy_secs,
            flops_per_sec: 2.0 * multiply_adds / multiply_add_secs,
        })
    }

    /// Best time of what `record` records, seconds.
    fn best_secs(&self, record: impl Fn(&mut wgpu::CommandEncoder)) -> Result<f64, GpuError> {
        let mut best = f64::INFINITY;
        let mut repetitions = 1_u32;
        loop {
            let mut encoder = self.encoder();
            for _ in 0..repetitions {
                record(&mut encoder);
            }
            let commands = encoder.finish();
            let start = Instant::now();
            self.queue().submit([commands]);
            let poll = self.raw().poll(wgpu::PollType::wait_indefinitely());
            let secs = start.elapsed().as_secs_f64();
            self.check()?;
            poll.map_err(|error| GpuError::Lost(error.to_string()))?;
            best = best.min(secs / f64::from(repetitions));
            if secs >= LONG_SECS {
                return Ok(best);
            }
            repetitions *= 2;
        }
    }
}
