//! Checks a device's prefix sums by subgroup operations. They rely on threads filling subgroups in
//! order and on reconvergence after divergent control flow. WGSL guarantees neither, and drivers have
//! got the latter wrong.

use super::layout::GROUP;
use super::stage::Stage;
use crate::GpuError;

/// Whether scans of known values on the device come out right.
///
/// # Errors
/// If the device fails.
pub fn scans_in_order(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    stage: &Stage,
) -> Result<bool, GpuError> {
    let group = GROUP as usize;
    let bytes = (2 * group * size_of::<[u32; 2]>()) as u64;
    let make = |usage| {
        device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("prefix sums"),
            size: bytes,
            usage,
            mapped_at_creation: false,
        })
    };
    let storage = wgpu::BufferUsages::STORAGE;
    let scanned = make(storage | wgpu::BufferUsages::COPY_SRC);
    let rounds = make(storage | wgpu::BufferUsages::COPY_DST);
    let copied = make(wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST);
    let numbers: Vec<u32> = (0..GROUP).collect();
    queue.write_buffer(&rounds, 0, bytemuck::cast_slice(&numbers));
    let buffers = stage.bind(device, |name| match name {
        "rounds" => Ok(&rounds),
        _ => Ok(&scanned),
    })?;
    let mut encoder = device.create_command_encoder(&Default::default());
    let mut pass = encoder.begin_compute_pass(&Default::default());
    pass.set_pipeline(&stage.pipeline);
    pass.set_bind_group(0, &buffers, &[]);
    pass.dispatch_workgroups(1, 1, 1);
    drop(pass);
    encoder.copy_buffer_to_buffer(&scanned, 0, &copied, 0, bytes);
    queue.submit([encoder.finish()]);
    copied.map_async(wgpu::MapMode::Read, .., |_| ());
    let failed = |error: &dyn std::fmt::Display| GpuError::Other(error.to_string());
    device
        .poll(wgpu::PollType::wait_indefinitely())
        .map_err(|error| failed(&error))?;
    let bytes = copied
        .get_mapped_range(..)
        .map_err(|error| failed(&error))?;
    let sums: Vec<[u32; 2]> = bytemuck::pod_collect_to_vec(&bytes);
    let value = |thread: u32| 3 * thread + 1;
    let third = |thread: u32| {
        if thread.is_multiple_of(3) {
            value(thread)
        } else {
            0
        }
    };
    Ok(are_prefix_sums(&sums[..group], value) && are_prefix_sums(&sums[group..], third))
}

/// Whether each thread has the sum of the values of the threads before it, and the total.
fn are_prefix_sums(scanned: &[[u32; 2]], value: impl Fn(u32) -> u32) -> bool {
    let all: u32 = (0..scanned.len() as u32).map(&value).sum();
    let mut before = 0;
    (0..).zip(scanned).all(|(thread, sums)| {
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
        let value = |thread| 3 * thread + 1;
        let mut sums = vec![[0, 12], [1, 12], [5, 12]];
        assert!(are_prefix_sums(&sums, value));
        sums.swap(0, 1);
        assert!(!are_prefix_sums(&sums, value));
        assert!(!are_prefix_sums(&[[0, 0]; 3], value));
    }
}
