//! Caches compiled pipelines between runs, in a folder chosen by the caller. If the cache cannot be
//! read or written, the driver simply compiles again.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The cache file for a device model.
pub struct PipelineCacheFile {
    path: PathBuf,
}

impl PipelineCacheFile {
    /// `None` if the backend has no pipeline cache.
    pub fn of(info: &wgpu::AdapterInfo, folder: &Path) -> Option<Self> {
        let name = wgpu::util::pipeline_cache_key(info)?;
        Some(Self {
            path: folder.join(name),
        })
    }

    /// The saved cache, or an empty one.
    pub fn load(&self, device: &wgpu::Device) -> wgpu::PipelineCache {
        let data = fs::read(&self.path).ok();
        let descriptor = wgpu::PipelineCacheDescriptor {
            label: Some("fgs"),
            data: data.as_deref(),
            fallback: true,
        };
        // SAFETY: the data is what `save` wrote for this device model, in a folder that the caller
        // vouches for (see `GpuDevice::find`); wgpu validates the header and falls back to an empty
        // cache.
        unsafe { device.create_pipeline_cache(&descriptor) }
    }

    /// Replaces the file atomically if the cache has changed.
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
        // Without the file the next run only takes longer to start.
        let _ = write();
    }
}
