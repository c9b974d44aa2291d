//! A graphics device: selection, minimum requirements, buffers, and the errors that it reports.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use bytemuck::Pod;
use wgpu::util::DeviceExt;

use super::pipeline_cache::PipelineCacheFile;
use super::scan_check::scans_in_order;
use super::stage::{Stage, StageOptions};
use crate::GpuError;

/// The most storage buffers that a stage binds.
pub(super) const STORAGE_BUFFERS: u32 = 8;
/// The most workgroup memory that a stage uses, bytes (WebGPU's guaranteed minimum).
pub(super) const WORKGROUP_BYTES: u32 = 16 << 10;
/// The largest workgroup, threads.
pub(super) const WORKGROUP_THREADS: u32 = super::layout::GROUP;
/// Required size of a storage buffer binding, bytes: WebGPU's guaranteed minimum, which holds two
/// million gaussians or entries of the tile lists.
const BINDING_BYTES: u64 = 128 << 20;

/// A compute device with its compiled pipelines. Clones share it.
#[derive(Clone)]
pub struct GpuDevice {
    shared: Arc<Shared>,
}

struct Shared {
    name: String,
    in_software: bool,
    caveats: Vec<&'static str>,
    device: wgpu::Device,
    queue: wgpu::Queue,
    stages: Vec<Stage>,
    binding_limit: u64,
    /// The first error that the device reported.
    failure: Arc<Mutex<Option<GpuError>>>,
}

impl std::fmt::Debug for GpuDevice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("GpuDevice").field(&self.shared.name).finish()
    }
}

impl GpuDevice {
    /// Opens the first device that meets the requirements, through Vulkan, Metal or DirectX 12:
    /// discrete GPUs come before integrated and virtual ones. A software device, which is slower than
    /// [`crate::CpuModel`], comes last and only if `accept_software`.
    ///
    /// Compiled pipelines are cached in the folder `pipeline_cache`, if one is given and the driver
    /// supports it. The driver trusts the cached files, so only the user may have write access.
    ///
    /// # Errors
    /// If there is no device, or none meets the requirements.
    pub fn find(accept_software: bool, pipeline_cache: Option<&Path>) -> Result<Self, GpuError> {
        Self::open(accept_software, pipeline_cache, |features| StageOptions {
            by_subgroups: features.contains(wgpu::Features::SUBGROUP),
            checked: false,
        })
    }

    /// As [`GpuDevice::find`], with control over how stages are compiled.
    pub(super) fn open(
        accept_software: bool,
        pipeline_cache: Option<&Path>,
        options: impl Fn(wgpu::Features) -> StageOptions,
    ) -> Result<Self, GpuError> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
            backends: wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12,
            // Validating an indirect dispatch costs an extra dispatch before each.
            flags: if cfg!(test) {
                wgpu::InstanceFlags::debugging()
            } else {
                wgpu::InstanceFlags::empty()
            },
            ..wgpu::InstanceDescriptor::new_without_display_handle()
        });
        let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
        let any = !adapters.is_empty();
        adapters.retain(|adapter| accept_software || !is_software(&adapter.get_info()));
        // Stable: among equals, the order in which the system lists them.
        adapters.sort_by_key(|adapter| match adapter.get_info().device_type {
            wgpu::DeviceType::DiscreteGpu => 0,
            wgpu::DeviceType::IntegratedGpu => 1,
            wgpu::DeviceType::VirtualGpu => 2,
            wgpu::DeviceType::Other => 3,
            wgpu::DeviceType::Cpu => 4,
        });
        let detail = if any { "only a software device" } else { "" };
        let mut refusal = GpuError::NoAdapter(detail.into());
        for (place, adapter) in adapters.iter().enumerate() {
            match Self::of_adapter(adapter, pipeline_cache, &options) {
                Ok(device) => return Ok(device),
                // If all fail, report why the fastest one did.
                Err(error) if place == 0 => refusal = error,
                Err(_) => {}
            }
        }
        Err(refusal)
    }

    fn of_adapter(
        adapter: &wgpu::Adapter,
        pipeline_cache: Option<&Path>,
        options: &impl Fn(wgpu::Features) -> StageOptions,
    ) -> Result<Self, GpuError> {
        let info = adapter.get_info();
        let name = format!("{} ({})", info.name, info.backend);
        check_limits(&name, &adapter.limits())?;

        let wanted = wgpu::Features::SUBGROUP
            | wgpu::Features::TIMESTAMP_QUERY
            | wgpu::Features::PIPELINE_CACHE;
        let features = adapter.features() & wanted;
        let request = adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("fgs"),
            required_features: features,
            required_limits: adapter.limits(),
            ..Default::default()
        });
        let (device, queue) =
            pollster::block_on(request).map_err(|error| GpuError::Other(error.to_string()))?;

        let failure = Arc::new(Mutex::new(None));
        let kept = failure.clone();
        device.on_uncaptured_error(Arc::new(move |error| note(&kept, translate(&error))));
        let kept = failure.clone();
        device.set_device_lost_callback(move |_, message| note(&kept, GpuError::Lost(message)));

        let cache = pipeline_cache
            .filter(|_| features.contains(wgpu::Features::PIPELINE_CACHE))
            .and_then(|folder| PipelineCacheFile::of(&info, folder));
        let pipelines = cache.as_ref().map(|cache| cache.load(&device));
        let limits = device.limits();
        let binding_limit = limits
            .max_storage_buffer_binding_size
            .min(limits.max_buffer_size);
        let make = |options, caveats| {
            let stages = Stage::make_all(&device, options, pipelines.as_ref());
            let opened = Self {
                shared: Arc::new(Shared {
                    name: name.clone(),
                    in_software: is_software(&info),
                    caveats,
                    device: device.clone(),
                    queue: queue.clone(),
                    stages: stages.map_err(GpuError::Other)?,
                    binding_limit,
                    failure: failure.clone(),
                }),
            };
            opened.check()?;
            Ok(opened)
        };
        let options = options(features);
        let mut caveats = caveats(&info, features);
        let mut opened = make(options, caveats.clone())?;
        if options.by_subgroups && !scans_in_order(&device, &queue, opened.stage("check_scan")?)? {
            caveats.push("subgroup operations disabled: they gave wrong prefix sums");
            let options = StageOptions {
                by_subgroups: false,
                ..options
            };
            opened = make(options, caveats)?;
        }
        if let (Some(cache), Some(pipelines)) = (&cache, &pipelines) {
            cache.save(pipelines);
        }
        Ok(opened)
    }

    /// The device's name and API, such as "NVIDIA H200 (vulkan)".
    pub fn name(&self) -> &str {
        &self.shared.name
    }

    /// Whether it is a software device, which is slower than [`crate::CpuModel`].
    pub fn is_software(&self) -> bool {
        self.shared.in_software
    }

    /// Known causes of poor performance that the user may be able to fix, as phrases to print.
    pub fn caveats(&self) -> &[&'static str] {
        &self.shared.caveats
    }

    pub(super) fn raw(&self) -> &wgpu::Device {
        &self.shared.device
    }

    pub(super) fn queue(&self) -> &wgpu::Queue {
        &self.shared.queue
    }

    /// The largest buffer that a stage can bind, bytes.
    pub(super) fn binding_limit(&self) -> u64 {
        self.shared.binding_limit
    }

    /// A new command encoder.
    pub(super) fn encoder(&self) -> wgpu::CommandEncoder {
        self.raw().create_command_encoder(&Default::default())
    }

    /// The stage with that entry point, or an error.
    pub(super) fn stage(&self, name: &str) -> Result<&Stage, GpuError> {
        let found = self.shared.stages.iter().find(|stage| stage.name == name);
        found.ok_or_else(|| GpuError::Other(format!("there is no stage {name}")))
    }

    /// Fails if the device has reported an error.
    pub(super) fn check(&self) -> Result<(), GpuError> {
        let Some(error) = self.failure() else {
            return Ok(());
        };
        // If the device was lost, calls made since then fail first; polling reports the loss itself.
        let _ = self.raw().poll(wgpu::PollType::wait_indefinitely());
        Err(self.failure().unwrap_or(error))
    }

    fn failure(&self) -> Option<GpuError> {
        let failure = self.shared.failure.lock();
        failure.unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// A zero-initialised buffer. `what` names its contents in the plural, for messages.
    ///
    /// # Errors
    /// If the device cannot bind that much or is out of memory.
    pub(super) fn buffer(
        &self,
        what: &'static str,
        bytes: u64,
        usage: wgpu::BufferUsages,
    ) -> Result<wgpu::Buffer, GpuError> {
        let limit = self.binding_limit();
        if bytes > limit {
            return Err(GpuError::TooLarge {
                what,
                needed: bytes,
                limit,
            });
        }
        let usage = usage
            | match usage {
                // A mappable buffer cannot be the source of a copy.
                wgpu::BufferUsages::MAP_READ => wgpu::BufferUsages::COPY_DST,
                _ => wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST,
            };
        let scope = self.raw().push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let buffer = self.raw().create_buffer(&wgpu::BufferDescriptor {
            label: Some(what),
            size: bytes.next_multiple_of(4).max(256),
            usage,
            mapped_at_creation: false,
        });
        match pollster::block_on(scope.pop()) {
            Some(error) => Err(translate(&error)),
            None => Ok(buffer),
        }
    }

    /// A storage and uniform buffer with the given contents.
    pub(super) fn buffer_of<T: Pod>(&self, what: &'static str, entries: &[T]) -> wgpu::Buffer {
        self.raw()
            .create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some(what),
                contents: bytemuck::cast_slice(entries),
                usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::UNIFORM,
            })
    }
}

/// Keeps the first error, since later ones mostly follow from it; but device loss replaces any other,
/// as their cause.
fn note(kept: &Mutex<Option<GpuError>>, error: GpuError) {
    let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
    let explains = matches!(error, GpuError::Lost(_)) && !matches!(*kept, Some(GpuError::Lost(_)));
    if kept.is_none() || explains {
        *kept = Some(error);
    }
}

fn translate(error: &wgpu::Error) -> GpuError {
    match error {
        wgpu::Error::OutOfMemory { .. } => GpuError::OutOfMemory(String::new()),
        other => GpuError::Other(other.to_string()),
    }
}

fn is_software(info: &wgpu::AdapterInfo) -> bool {
    info.device_type == wgpu::DeviceType::Cpu
}

fn caveats(info: &wgpu::AdapterInfo, features: wgpu::Features) -> Vec<&'static str> {
    let mut caveats = Vec::new();
    if is_software(info) {
        caveats.push("a software device, slower than the CPU backend");
    }
    // FXC stops at shader model 5.1, without subgroup operations; DXC starts at 6.0, with them.
    if info.backend == wgpu::Backend::Dx12 && !features.contains(wgpu::Features::SUBGROUP) {
        caveats.push("shaders compiled by FXC, since dxcompiler.dll was not found");
    }
    caveats
}

fn check_limits(name: &str, limits: &wgpu::Limits) -> Result<(), GpuError> {
    let needs = [
        (
            "storage buffers per shader stage",
            u64::from(limits.max_storage_buffers_per_shader_stage),
            u64::from(STORAGE_BUFFERS),
        ),
        (
            "bytes of workgroup memory",
            limits.max_compute_workgroup_storage_size.into(),
            WORKGROUP_BYTES.into(),
        ),
        (
            "threads per workgroup",
            limits.max_compute_invocations_per_workgroup.into(),
            WORKGROUP_THREADS.into(),
        ),
        (
            "bytes per storage buffer binding",
            limits.max_storage_buffer_binding_size,
            BINDING_BYTES,
        ),
    ];
    for (what, has, needed) in needs {
        if has < needed {
            return Err(GpuError::Unfit {
                device: name.into(),
                what: format!("it has {has} {what}, but {needed} are needed"),
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_slows_a_device_down_is_said() {
        let info = |kind, backend| wgpu::AdapterInfo::new(kind, backend);
        let (gpu, cpu) = (wgpu::DeviceType::DiscreteGpu, wgpu::DeviceType::Cpu);
        let of = |kind, backend, features| caveats(&info(kind, backend), features).len();
        let (all, none) = (wgpu::Features::SUBGROUP, wgpu::Features::empty());
        assert_eq!(of(gpu, wgpu::Backend::Vulkan, none), 0);
        assert_eq!(of(gpu, wgpu::Backend::Dx12, all), 0);
        assert_eq!(of(gpu, wgpu::Backend::Dx12, none), 1);
        assert_eq!(of(cpu, wgpu::Backend::Dx12, none), 2);
    }

    #[test]
    fn a_device_below_the_limits_is_refused_by_name() {
        let enough = wgpu::Limits::default();
        assert_eq!(check_limits("Toy", &enough), Ok(()));
        let limits = wgpu::Limits {
            max_compute_workgroup_storage_size: 8192,
            ..enough
        };
        let message = check_limits("Toy", &limits).unwrap_err().to_string();
        assert_eq!(
            message,
            "Toy cannot be used: it has 8192 bytes of workgroup memory, but 16384 are needed"
        );
    }
}
