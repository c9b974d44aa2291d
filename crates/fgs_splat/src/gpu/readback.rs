//! Readback: copies of device buffers, through mappable staging buffers.

use std::sync::mpsc;

use bytemuck::Pod;

use super::device::GpuDevice;
use crate::GpuError;

#[cfg(test)]
thread_local! {
    /// How many times this thread has waited for the device.
    pub static WAITS: std::cell::Cell<usize> = const { std::cell::Cell::new(0) };
}

/// Reads `len` entries of a buffer from entry `first` on. Waits for everything submitted so far.
///
/// # Errors
/// If the device fails.
pub fn read<T: Pod>(
    device: &GpuDevice,
    buffer: &wgpu::Buffer,
    first: usize,
    len: usize,
) -> Result<Vec<T>, GpuError> {
    let size = size_of::<T>();
    let parts = read_parts(device, &[(buffer, first * size, len * size)])?;
    Ok(bytemuck::pod_collect_to_vec(&parts.concat()))
}

/// As [`read`], for parts of several buffers, each given by its offset and length in bytes.
///
/// # Errors
/// If the device fails.
pub fn read_parts(
    device: &GpuDevice,
    parts: &[(&wgpu::Buffer, usize, usize)],
) -> Result<Vec<Vec<u8>>, GpuError> {
    let total: usize = parts.iter().map(|(.., bytes)| bytes).sum();
    if total == 0 {
        return Ok(vec![Vec::new(); parts.len()]);
    }
    let landing = Landing::new(device, total as u64)?;
    let mut encoder = device.encoder();
    let mut at = 0;
    for (buffer, first, bytes) in parts {
        let [first, bytes] = [*first, *bytes].map(|x| x as u64);
        if bytes > 0 {
            encoder.copy_buffer_to_buffer(buffer, first, &landing.buffer, at, bytes);
        }
        at += bytes;
    }
    let arrival = landing.expect(device.queue().submit([encoder.finish()]));
    let (copies, _) = arrival.take(device, |mut rest| {
        let mut copies = Vec::with_capacity(parts.len());
        for (.., bytes) in parts {
            let (part, after) = rest.split_at(*bytes);
            copies.push(part.to_vec());
            rest = after;
        }
        copies
    })?;
    Ok(copies)
}

/// A mappable staging buffer.
pub struct Landing {
    buffer: wgpu::Buffer,
    bytes: u64,
}

/// A pending readback.
pub struct Arrival {
    landing: Landing,
    submission: wgpu::SubmissionIndex,
    done: mpsc::Receiver<Result<(), wgpu::BufferAsyncError>>,
}

impl Landing {
    /// A staging buffer of that size.
    ///
    /// # Errors
    /// If the device is out of memory.
    pub fn new(device: &GpuDevice, bytes: u64) -> Result<Self, GpuError> {
        let buffer = device.buffer("copies to the host", bytes, wgpu::BufferUsages::MAP_READ)?;
        Ok(Self { buffer, bytes })
    }

    /// The destination of copies.
    pub fn buffer(&self) -> &wgpu::Buffer {
        &self.buffer
    }

    /// Requests the mapping once this submission, which copies into the buffer, has completed.
    pub fn expect(self, submission: wgpu::SubmissionIndex) -> Arrival {
        let (sender, done) = mpsc::channel();
        let bytes = self.bytes;
        self.buffer
            .map_async(wgpu::MapMode::Read, 0..bytes, move |result| {
                // The receiver may have been dropped.
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
    /// Waits for the submission and passes the bytes to `use_bytes`. Returns the buffer for reuse.
    ///
    /// # Errors
    /// If the device fails.
    pub fn take<R>(
        self,
        device: &GpuDevice,
        use_bytes: impl FnOnce(&[u8]) -> R,
    ) -> Result<(R, Landing), GpuError> {
        device.check()?;
        #[cfg(test)]
        WAITS.with(|waits| waits.set(waits.get() + 1));
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
        let result = use_bytes(&bytes);
        drop(bytes);
        buffer.unmap();
        Ok((result, self.landing))
    }
}
