//! Devices for tests. Without one, tests that need it are skipped and say how many.

use std::io::Write;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::gpu::GpuDevice;
use crate::gpu::stage::StageOptions;

static SKIPPED: AtomicUsize = AtomicUsize::new(0);

/// A device of any kind, shared by all tests, with bounds checks, and with subgroup operations if it
/// supports them. `None` if there is no device.
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
        // Not through `eprintln`, which the test harness captures.
        let message = format!("no graphics device was found: {skipped} tests skipped so far\n");
        let _ = std::io::stderr().write_all(message.as_bytes());
    }
    device.clone()
}

/// A device whose stages are compiled with these options. `None` if there is no device.
pub fn open(options: impl Fn(wgpu::Features) -> StageOptions) -> Option<GpuDevice> {
    match GpuDevice::open(true, None, options) {
        Ok(device) => Some(device),
        Err(crate::GpuError::NoAdapter(_)) => None,
        Err(error) => panic!("{error}"),
    }
}
