//! Times stages with the device's timestamp queries.

use super::device::GpuDevice;
use super::readback;
use crate::GpuError;

/// More than a step has.
const MAX_STAGES: u32 = 64;

/// Times the stages of one submission.
pub struct StageTimer {
    queries: wgpu::QuerySet,
    ticks: wgpu::Buffer,
    stages: Vec<&'static str>,
}

impl StageTimer {
    /// `None` if the device has no timestamp queries.
    ///
    /// # Errors
    /// If the device is out of memory.
    pub fn new(device: &GpuDevice) -> Result<Option<Self>, GpuError> {
        if !device
            .raw()
            .features()
            .contains(wgpu::Features::TIMESTAMP_QUERY)
        {
            return Ok(None);
        }
        let count = 2 * MAX_STAGES;
        Ok(Some(Self {
            queries: device.raw().create_query_set(&wgpu::QuerySetDescriptor {
                label: None,
                ty: wgpu::QueryType::Timestamp,
                count,
            }),
            ticks: device.buffer(
                "clock readings",
                u64::from(8 * count),
                wgpu::BufferUsages::QUERY_RESOLVE,
            )?,
            stages: Vec::new(),
        }))
    }

    /// The queries for the next stage's start and end; `None` if all are in use.
    pub(super) fn next(
        &mut self,
        stage: &'static str,
    ) -> Option<wgpu::ComputePassTimestampWrites<'_>> {
        let first = 2 * u32::try_from(self.stages.len()).ok()?;
        if first >= 2 * MAX_STAGES {
            return None;
        }
        self.stages.push(stage);
        Some(wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: Some(first + 1),
        })
    }

    /// Records the copy of the timestamps into a buffer.
    pub(super) fn resolve(&self, encoder: &mut wgpu::CommandEncoder) {
        let count = 2 * self.stages.len() as u32;
        encoder.resolve_query_set(&self.queries, 0..count, &self.ticks, 0);
    }

    /// Waits for the submission and returns its stages in order, with their milliseconds. Resets the
    /// timer.
    ///
    /// # Errors
    /// If the device fails.
    pub(super) fn take(
        &mut self,
        device: &GpuDevice,
    ) -> Result<Vec<(&'static str, f64)>, GpuError> {
        let stages = std::mem::take(&mut self.stages);
        let ticks: Vec<u64> = readback::read(device, &self.ticks, 0, 2 * stages.len())?;
        let tick_ms = 1e-6 * f64::from(device.queue().get_timestamp_period());
        let times = ticks.as_chunks::<2>().0.iter();
        let times = times.map(|[start, end]| tick_ms * end.saturating_sub(*start) as f64);
        Ok(stages.into_iter().zip(times).collect())
    }
}
