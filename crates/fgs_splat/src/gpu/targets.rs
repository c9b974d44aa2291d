//! The measured images of views on the device: those used last, up to a number. The others wait in
//! the host's memory.

use std::collections::BTreeMap;

use fgs_geom::{Image, KeyframeId};

use super::device::GpuDevice;
use super::error::GpuError;
use crate::Target;

/// Targets by view.
pub struct ResidentTargets {
    max: usize,
    /// With the time of their last use.
    buffers: BTreeMap<KeyframeId, (wgpu::Buffer, u64)>,
    uses: u64,
}

impl ResidentTargets {
    /// Keeps up to `max` of them, but at least one.
    pub fn new(max: usize) -> Self {
        Self {
            max: max.max(1),
            buffers: BTreeMap::new(),
            uses: 0,
        }
    }

    /// A view's target on the device, pixel by pixel: a word with eight bits of each colour and 1
    /// or 0 in the fourth byte, whether they are valid; then the bits of the depth in metres.
    ///
    /// # Errors
    /// If the device's memory does not suffice.
    pub fn get(
        &mut self,
        device: &GpuDevice,
        id: KeyframeId,
        target: &Target,
    ) -> Result<wgpu::Buffer, GpuError> {
        self.uses += 1;
        if let Some((buffer, last_use)) = self.buffers.get_mut(&id) {
            *last_use = self.uses;
            return Ok(buffer.clone());
        }
        while self.buffers.len() >= self.max {
            let oldest = self
                .buffers
                .iter()
                .min_by_key(|(_, (_, last_use))| *last_use);
            let Some(oldest) = oldest.map(|(id, _)| *id) else {
                break;
            };
            self.buffers.remove(&oldest);
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
        let usage = wgpu::BufferUsages::STORAGE;
        let buffer = device.buffer("a keyframe's images", bytes.len() as u64, usage)?;
        device.queue().write_buffer(&buffer, 0, bytes);
        self.buffers.insert(id, (buffer.clone(), self.uses));
        Ok(buffer)
    }

    /// Forgets a view.
    pub fn remove(&mut self, id: KeyframeId) {
        self.buffers.remove(&id);
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        self.buffers.values().map(|(buffer, _)| buffer.size()).sum()
    }
}
