//! Caches compiled pipelines between runs, in a folder chosen by the caller.
//! What cannot be read or written is left out: then the driver compiles anew.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The file for one kind of device.
pub struct PipelineCacheFile {
    path: PathBuf,
}

impl PipelineCacheFile {
    /// `None` if the device has no name for its kind.
    pub fn of(info: &wgpu::AdapterInfo, folder: &Path) -> Option<Self> {
        let name = wgpu::util::pipeline_cache_key(info)?;
        Some(Self {
            path: folder.join(name),
        })
    }

    /// What was saved, or an empty cache.
    pub fn load(&self, device: &wgpu::Device) -> wgpu::PipelineCache {
        let data = fs::read(&self.path).ok();
        let descriptor = wgpu::PipelineCacheDescriptor {
            label: Some("fgs"),
            data: data.as_deref(),
            fallback: true,
        };
        // SAFETY: the data is what `save` wrote for this kind of device, in a folder that the caller
        // vouches for (see `GpuDevice::find`); wgpu checks its header and falls back.
        unsafe { device.create_pipeline_cache(&descriptor) }
    }

    /// Replaces the file, at once or not at all, if there is anything new.
    pub fn save(&self, pipelines: &wgpu::PipelineCache) {
        let Some(data) = pipelines.get_data() else {
            return;
        };
        if fs::read(&self.path).is_ok_and(|saved| saved == data) {
            return;
        }
        let write = || {
            let folder = self.path.parent()?;
            fs::create_dir_all(folder).ok()?;
            fgs_files::write_file(&self.path, |file| file.write_all(&data)).ok()
        };
        // A cache that cannot be kept costs time alone.
        let _ = write();
    }
}
