//! Copies of what lies on the device.

use std::sync::mpsc;

use bytemuck::Pod;

use super::device::GpuDevice;
use super::error::GpuError;

#[cfg(test)]
thread_local! {
    /// How many times this thread has waited for the device.
    pub static WAITS: std::cell::Cell<usize> = const { std::cell::Cell::new(0) };
}

/// Entries of a buffer: the first of them, and how many.
pub type Part<'a> = (&'a wgpu::Buffer, usize, usize);

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
    let (entries, _) = read_both::<T, u8>(device, (buffer, first, len), (buffer, 0, 0))?;
    Ok(entries)
}

/// As [`read`], parts of two buffers at once.
///
/// # Errors
/// If the device fails.
pub fn read_both<A: Pod, B: Pod>(
    device: &GpuDevice,
    (a, first_a, len_a): Part<'_>,
    (b, first_b, len_b): Part<'_>,
) -> Result<(Vec<A>, Vec<B>), GpuError> {
    let [size_a, size_b] = [size_of::<A>(), size_of::<B>()];
    let (bytes_a, bytes_b) = (len_a * size_a, len_b * size_b);
    if bytes_a + bytes_b == 0 {
        return Ok((Vec::new(), Vec::new()));
    }
    let landing = Landing::new(device, (bytes_a + bytes_b) as u64)?;
    let mut encoder = device.encoder();
    for (buffer, first, at, bytes) in [
        (a, first_a * size_a, 0, bytes_a),
        (b, first_b * size_b, bytes_a, bytes_b),
    ] {
        if bytes > 0 {
            let [first, at, bytes] = [first, at, bytes].map(|x| x as u64);
            encoder.copy_buffer_to_buffer(buffer, first, &landing.buffer, at, bytes);
        }
    }
    let submission = device.queue().submit([encoder.finish()]);
    let arrival = landing.expect(submission);
    let (parts, _) = arrival.take(device, |bytes| {
        let (a, b) = bytes.split_at(bytes_a);
        (
            bytemuck::pod_collect_to_vec(a),
            bytemuck::pod_collect_to_vec(b),
        )
    })?;
    Ok(parts)
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
    /// Waits for the copy and hands its bytes over; gives the memory back to be used again.
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
