//! Which views' measured images lie on the device: those used last, within a budget of bytes. The
//! others wait in the host's memory and are uploaded when they are needed.

use std::collections::BTreeMap;

use fgs_geom::Image;

use super::buffers::Buffers;
use super::device::GpuDevice;
use crate::GpuError;
use crate::Target;

/// The most that is spent on targets: 200 keyframes of 1200x680 take 1.3 GB.
const MOST_BYTES: u64 = 3 << 29;

/// Bytes to spend on a device. No interface that wgpu stands on says how much memory is free; the
/// largest buffer that a device allows is the one figure that grows with what it has.
pub fn budget(device: &GpuDevice) -> u64 {
    device.raw().limits().max_buffer_size.min(MOST_BYTES)
}

/// Targets by the set of their view.
pub struct ResidentTargets {
    budget: u64,
    /// The time of their last use.
    last_uses: BTreeMap<u32, u64>,
    uses: u64,
}

impl ResidentTargets {
    /// Keeps so many bytes of them, but at least one.
    pub fn new(budget: u64) -> Self {
        Self {
            budget,
            last_uses: BTreeMap::new(),
            uses: 0,
        }
    }

    /// Uploads a view's target unless it is there, pixel by pixel: a word with eight bits of each
    /// colour and 1 or 0 in the fourth byte, whether they are valid; then the bits of the depth in
    /// metres.
    ///
    /// # Errors
    /// If the device's memory does not suffice.
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
            && self.forget_oldest(buffers)
        {}
        let buffer = loop {
            let usage = wgpu::BufferUsages::STORAGE;
            match device.buffer("a keyframe's images", bytes.len() as u64, usage) {
                Err(GpuError::OutOfMemory(_)) if self.forget_oldest(buffers) => {}
                buffer => break buffer?,
            }
        };
        device.queue().write_buffer(&buffer, 0, bytes);
        buffers.set_target(set, buffer);
        self.last_uses.insert(set, self.uses);
        Ok(())
    }

    /// Forgets a view.
    pub fn remove(&mut self, buffers: &mut Buffers, set: u32) {
        self.last_uses.remove(&set);
        buffers.remove_target(set);
    }

    /// Whether there was one.
    fn forget_oldest(&mut self, buffers: &mut Buffers) -> bool {
        let oldest = self.last_uses.iter().min_by_key(|(_, last_use)| **last_use);
        let Some(oldest) = oldest.map(|(set, _)| *set) else {
            return false;
        };
        self.remove(buffers, oldest);
        true
    }
}
