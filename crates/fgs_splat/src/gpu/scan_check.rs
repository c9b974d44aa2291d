//! Whether prefix sums by subgroup operations are right on a device. They take it that threads fill
//! subgroups in order, as they do wherever anyone has looked, but no specification promises it.

use super::device::GpuDevice;
use super::error::GpuError;
use super::layout::GROUP;
use super::readback::read;

impl GpuDevice {
    /// Scans known values and compares.
    ///
    /// # Errors
    /// If the device fails.
    pub(super) fn scans_in_order(&self) -> Result<bool, GpuError> {
        let bytes = 8 * u64::from(GROUP);
        let scanned = self.buffer("prefix sums", bytes, wgpu::BufferUsages::STORAGE)?;
        let stage = self.stage("check_scan")?;
        let buffers = stage.bind(self.raw(), |_| Ok(&scanned))?;
        let mut encoder = self.encoder();
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&stage.pipeline);
        pass.set_bind_group(0, &buffers, &[]);
        pass.dispatch_workgroups(1, 1, 1);
        drop(pass);
        self.queue().submit([encoder.finish()]);
        let scanned: Vec<[u32; 2]> = read(self, &scanned, 0, GROUP as usize)?;
        Ok(are_prefix_sums(&scanned))
    }
}

/// Whether these are the sums before each value, and of all, of 1, 4, 7, ...
fn are_prefix_sums(scanned: &[[u32; 2]]) -> bool {
    let value = |thread: usize| 3 * thread as u32 + 1;
    let all: u32 = (0..scanned.len()).map(value).sum();
    let mut before = 0;
    scanned.iter().enumerate().all(|(thread, sums)| {
        let right = *sums == [before, all];
        before += value(thread);
        right
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_in_another_order_are_found_out() {
        let mut sums = vec![[0, 12], [1, 12], [5, 12]];
        assert!(are_prefix_sums(&sums));
        sums.swap(0, 1);
        assert!(!are_prefix_sums(&sums));
        assert!(!are_prefix_sums(&[[0, 0]; 3]));
    }
}
