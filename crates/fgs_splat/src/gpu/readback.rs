//! Copies of what lies on the device.

use std::sync::mpsc;

use bytemuck::Pod;

use super::device::GpuDevice;
use super::error::GpuError;

/// Waits for all that was submitted and copies `len` entries, the first of them entry `first`.
///
/// # Errors
/// If the device fails.
pub fn read<T: Pod>(
    device: &GpuDevice,
    buffer: &wgpu::Buffer,
    first: usize,
    len: usize,
) -> Result<Vec<T>, GpuError> {
    if len == 0 {
        return Ok(Vec::new());
    }
    let [start, bytes] = [first, len].map(|entries| (entries * size_of::<T>()) as u64);
    let landing = Landing::new(device, bytes)?;
    let mut encoder = device.raw().create_command_encoder(&Default::default());
    encoder.copy_buffer_to_buffer(buffer, start, &landing.buffer, 0, bytes);
    let submission = device.queue().submit([encoder.finish()]);
    landing.expect(submission).take(device)
}

/// Memory of the host that the device copies to.
pub struct Landing {
    buffer: wgpu::Buffer,
    bytes: u64,
}

/// A copy that is on its way.
pub struct Arrival {
    landing: Landing,
    submission: wgpu::SubmissionIndex,
    done: mpsc::Receiver<Result<(), wgpu::BufferAsyncError>>,
}

impl Landing {
    /// # Errors
    /// If the memory does not suffice.
    pub fn new(device: &GpuDevice, bytes: u64) -> Result<Self, GpuError> {
        let buffer = device.buffer("copies to the host", bytes, wgpu::BufferUsages::MAP_READ)?;
        Ok(Self { buffer, bytes })
    }

    /// To be copied to.
    pub fn buffer(&self) -> &wgpu::Buffer {
        &self.buffer
    }

    /// Asks for what the submission copies to it.
    pub fn expect(self, submission: wgpu::SubmissionIndex) -> Arrival {
        let (sender, done) = mpsc::channel();
        let bytes = self.bytes;
        self.buffer
            .map_async(wgpu::MapMode::Read, 0..bytes, move |result| {
                // Nobody waits any more: then nobody needs to know.
                let _ = sender.send(result);
            });
        Arrival {
            landing: self,
            submission,
            done,
        }
    }
}

impl Arrival {
    /// Waits for the copy.
    ///
    /// # Errors
    /// If the device fails.
    pub fn take<T: Pod>(self, device: &GpuDevice) -> Result<Vec<T>, GpuError> {
        self.take_and_keep(device).map(|(entries, _)| entries)
    }

    /// Waits for the copy; gives the memory back to be used again.
    ///
    /// # Errors
    /// If the device fails.
    pub fn take_and_keep<T: Pod>(self, device: &GpuDevice) -> Result<(Vec<T>, Landing), GpuError> {
        device.check()?;
        let poll = device.raw().poll(wgpu::PollType::Wait {
            submission_index: Some(self.submission),
            timeout: None,
        });
        device.check()?;
        let lost = |error: &dyn std::fmt::Display| GpuError::Lost(error.to_string());
        poll.map_err(|error| lost(&error))?;
        let mapped = self.done.recv().map_err(|error| lost(&error))?;
        mapped.map_err(|error| lost(&error))?;
        let buffer = &self.landing.buffer;
        let bytes = buffer
            .get_mapped_range(0..self.landing.bytes)
            .map_err(|error| GpuError::Other(error.to_string()))?;
        let entries = bytemuck::pod_collect_to_vec(&bytes);
        drop(bytes);
        buffer.unmap();
        Ok((entries, self.landing))
    }
}
