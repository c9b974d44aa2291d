//! Devices for tests. Where there is none, the tests that need one are skipped, and say how many.

use std::io::Write;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::gpu::GpuDevice;
use crate::gpu::stage::StageOptions;

static SKIPPED: AtomicUsize = AtomicUsize::new(0);

/// A device of any kind, shared by all tests, every access to memory checked; subgroup operations
/// where it has them. `None` if there is none.
pub fn device() -> Option<GpuDevice> {
    static DEVICE: OnceLock<Option<GpuDevice>> = OnceLock::new();
    let device = DEVICE.get_or_init(|| {
        open(|features| StageOptions {
            by_subgroups: features.contains(wgpu::Features::SUBGROUP),
            checked: true,
        })
    });
    if device.is_none() {
        let skipped = SKIPPED.fetch_add(1, Ordering::Relaxed) + 1;
        // Not through `eprintln`, which the test harness keeps to itself.
        let message = format!("no graphics device was found: {skipped} tests skipped so far\n");
        let _ = std::io::stderr().write_all(message.as_bytes());
    }
    device.clone()
}

/// A device whose stages are made like that.
pub fn open(options: impl Fn(wgpu::Features) -> StageOptions) -> Option<GpuDevice> {
    match GpuDevice::open(true, None, options) {
        Ok(device) => Some(device),
        Err(crate::GpuError::NoAdapter(_)) => None,
        Err(error) => panic!("{error}"),
    }
}
