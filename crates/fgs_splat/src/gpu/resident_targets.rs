//! Keeps the measured images of the most recently used views on the device, within a budget. All are
//! in host memory too and are uploaded when they are needed.

use std::collections::BTreeMap;

use fgs_geom::Image;

use super::buffers::Buffers;
use super::device::GpuDevice;
use crate::GpuError;
use crate::Target;

/// The largest budget, bytes: 200 keyframes of 1200x680 take 1.3 GB.
const MOST_BYTES: u64 = 3 << 29;

/// The budget on a device, bytes. wgpu cannot query free memory; the largest allowed buffer is the
/// only limit that grows with a device's memory.
pub fn budget(device: &GpuDevice) -> u64 {
    device.raw().limits().max_buffer_size.min(MOST_BYTES)
}

/// Least-recently-used bookkeeping, by the view's visibility set.
pub struct ResidentTargets {
    budget: u64,
    /// The value of `uses` at each target's last use.
    last_uses: BTreeMap<u32, u64>,
    uses: u64,
}

impl ResidentTargets {
    /// Keeps up to `budget` bytes of targets, but at least one target.
    pub fn new(budget: u64) -> Self {
        Self {
            budget,
            last_uses: BTreeMap::new(),
            uses: 0,
        }
    }

    /// Uploads a view's target unless it is resident, as two words per pixel: RGB with 8 bits each
    /// and, in the fourth byte, 1 if the camera saw the colour, else 0; then the bits of the depth in
    /// metres.
    ///
    /// # Errors
    /// If the device is out of memory.
    pub fn require(
        &mut self,
        device: &GpuDevice,
        buffers: &mut Buffers,
        set: u32,
        target: &Target,
    ) -> Result<(), GpuError> {
        self.uses += 1;
        if let Some(last_use) = self.last_uses.get_mut(&set) {
            *last_use = self.uses;
            return Ok(());
        }
        let colors = target.color().data().iter();
        let valid = target.color_valid().map(Image::data);
        let pixels: Vec<[u32; 2]> = colors
            .zip(target.depth_m().data())
            .enumerate()
            .map(|(i, ([r, g, b], depth_m))| {
                let valid = valid.is_none_or(|valid| valid[i]);
                let color = u32::from_le_bytes([*r, *g, *b, valid.into()]);
                [color, depth_m.to_bits()]
            })
            .collect();
        let bytes: &[u8] = bytemuck::cast_slice(&pixels);
        while buffers.target_bytes() + bytes.len() as u64 > self.budget
            && self.evict_oldest(buffers)
        {}
        let buffer = loop {
            let usage = wgpu::BufferUsages::STORAGE;
            match device.buffer("a keyframe's images", bytes.len() as u64, usage) {
                Err(GpuError::OutOfMemory(_)) if self.evict_oldest(buffers) => {}
                buffer => break buffer?,
            }
        };
        device.queue().write_buffer(&buffer, 0, bytes);
        buffers.set_target(set, buffer);
        self.last_uses.insert(set, self.uses);
        Ok(())
    }

    /// Evicts a view's target, if it is resident.
    pub fn remove(&mut self, buffers: &mut Buffers, set: u32) {
        self.last_uses.remove(&set);
        buffers.remove_target(set);
    }

    /// Evicts the least recently used target. Returns whether there was one.
    fn evict_oldest(&mut self, buffers: &mut Buffers) -> bool {
        let oldest = self.last_uses.iter().min_by_key(|(_, last_use)| **last_use);
        let Some(oldest) = oldest.map(|(set, _)| *set) else {
            return false;
        };
        self.remove(buffers, oldest);
        true
    }
}
