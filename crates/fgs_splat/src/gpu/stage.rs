//! Stages: the compute pipelines and the buffers that each binds.
//!
//! A shader's source is the generated preamble, files of shared functions and the shader's own file,
//! concatenated. An entry point's bindings are found by reflection, so Rust need not list them.

use wgpu::naga;

use super::layout::preamble;
use super::taps::unroll_taps;
use crate::GpuError;

/// A shader: a file of entry points, preceded by the files of shared functions that it needs.
pub struct ShaderFile {
    pub name: &'static str,
    parts: &'static [&'static str],
    entry_points: &'static [&'static str],
}

/// Prefix sums over a workgroup, without and with subgroup operations.
const WORKGROUP_SCAN: &str = include_str!("shaders/workgroup_scan.wgsl");
const WORKGROUP_SCAN_BY_SUBGROUPS: &str = include_str!("shaders/workgroup_scan_by_subgroups.wgsl");

const BLOCK_SCAN: &str = include_str!("shaders/block_scan.wgsl");
const WORKGROUP_SUM: &str = include_str!("shaders/workgroup_sum.wgsl");
const PROJECTION: &str = include_str!("shaders/projection.wgsl");
const BOUNDS: &str = include_str!("shaders/bounds.wgsl");
const IN_VIEW: &str = include_str!("shaders/in_view.wgsl");
const SAMPLE: &str = include_str!("shaders/sample.wgsl");
const LOSS_IMAGE: &str = include_str!("shaders/loss_image.wgsl");

/// All shaders.
pub const SHADER_FILES: &[ShaderFile] = &[
    ShaderFile {
        name: "cull",
        parts: &[
            WORKGROUP_SCAN,
            BLOCK_SCAN,
            PROJECTION,
            BOUNDS,
            IN_VIEW,
            include_str!("shaders/cull.wgsl"),
        ],
        entry_points: &["count_in_view", "place_in_view"],
    },
    ShaderFile {
        name: "project",
        parts: &[
            WORKGROUP_SCAN,
            BLOCK_SCAN,
            PROJECTION,
            BOUNDS,
            include_str!("shaders/project.wgsl"),
        ],
        entry_points: &["project"],
    },
    ShaderFile {
        name: "radix_sort",
        parts: &[WORKGROUP_SCAN, include_str!("shaders/radix_sort.wgsl")],
        entry_points: &["count_digits", "place_digits", "move_keys"],
    },
    ShaderFile {
        name: "tiles",
        parts: &[
            WORKGROUP_SCAN,
            BLOCK_SCAN,
            PROJECTION,
            BOUNDS,
            include_str!("shaders/tiles.wgsl"),
        ],
        entry_points: &[
            "count_touches",
            "place_touches",
            "write_touches",
            "find_ranges",
        ],
    },
    ShaderFile {
        name: "forward",
        parts: &[SAMPLE, include_str!("shaders/forward.wgsl")],
        entry_points: &["forward"],
    },
    ShaderFile {
        name: "ssim",
        parts: &[WORKGROUP_SUM, LOSS_IMAGE, include_str!("shaders/ssim.wgsl")],
        entry_points: &["ssim"],
    },
    ShaderFile {
        name: "losses",
        parts: &[
            WORKGROUP_SUM,
            LOSS_IMAGE,
            include_str!("shaders/losses.wgsl"),
        ],
        entry_points: &["losses"],
    },
    ShaderFile {
        name: "backward",
        parts: &[SAMPLE, include_str!("shaders/backward.wgsl")],
        entry_points: &["backward"],
    },
    ShaderFile {
        name: "project_vjp",
        parts: &[
            WORKGROUP_SCAN,
            PROJECTION,
            include_str!("shaders/project_vjp.wgsl"),
        ],
        entry_points: &["project_vjp"],
    },
    ShaderFile {
        name: "adam",
        parts: &[WORKGROUP_SUM, include_str!("shaders/adam.wgsl")],
        entry_points: &["adam"],
    },
    ShaderFile {
        name: "step_stats",
        parts: &[WORKGROUP_SUM, include_str!("shaders/step_stats.wgsl")],
        entry_points: &["step_stats"],
    },
    ShaderFile {
        name: "prune",
        parts: &[
            WORKGROUP_SCAN,
            BLOCK_SCAN,
            include_str!("shaders/prune.wgsl"),
        ],
        entry_points: &[
            "count_survivors",
            "place_survivors",
            "move_survivors",
            "move_rows",
            "move_sets",
        ],
    },
    ShaderFile {
        name: "fade_contradicted",
        parts: &[PROJECTION, include_str!("shaders/fade_contradicted.wgsl")],
        entry_points: &["fade_contradicted"],
    },
    ShaderFile {
        name: "see_through",
        parts: &[include_str!("shaders/see_through.wgsl")],
        entry_points: &["see_through"],
    },
    ShaderFile {
        name: "move_anchored",
        parts: &[include_str!("shaders/move_anchored.wgsl")],
        entry_points: &["move_anchored"],
    },
    ShaderFile {
        name: "scan_check",
        parts: &[WORKGROUP_SCAN, include_str!("shaders/scan_check.wgsl")],
        entry_points: &["check_scan"],
    },
    ShaderFile {
        name: "covisibility",
        parts: &[WORKGROUP_SCAN, include_str!("shaders/covisibility.wgsl")],
        entry_points: &["covisibility"],
    },
    ShaderFile {
        name: "rates",
        parts: &[include_str!("shaders/rates.wgsl")],
        entry_points: &["copy_rows", "multiply_add", "touch"],
    },
];

impl ShaderFile {
    /// The complete WGSL source.
    pub fn source(&self, by_subgroups: bool) -> String {
        let mut source = preamble();
        for part in self.parts {
            source.push_str(&unroll_taps(match *part {
                WORKGROUP_SCAN if by_subgroups => WORKGROUP_SCAN_BY_SUBGROUPS,
                part => part,
            }));
        }
        source
    }

    /// The parsed and validated module.
    ///
    /// # Errors
    /// If it is not valid WGSL; the message shows where.
    pub fn parse(
        &self,
        by_subgroups: bool,
    ) -> Result<(naga::Module, naga::valid::ModuleInfo), String> {
        let source = self.source(by_subgroups);
        let module = naga::front::wgsl::parse_str(&source)
            .map_err(|error| error.emit_to_string_with_path(&source, self.name))?;
        let capabilities = if by_subgroups {
            naga::valid::Capabilities::SUBGROUP
        } else {
            naga::valid::Capabilities::empty()
        };
        let mut validator =
            naga::valid::Validator::new(naga::valid::ValidationFlags::all(), capabilities);
        let info = validator
            .validate(&module)
            .map_err(|error| error.emit_to_string_with_path(&source, self.name))?;
        Ok((module, info))
    }
}

/// How shaders are compiled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StageOptions {
    /// Use subgroup operations for prefix sums.
    pub by_subgroups: bool,
    /// Bounds-check every buffer access.
    pub checked: bool,
}

/// A compute pipeline.
pub struct Stage {
    /// The entry point.
    pub name: &'static str,
    pub pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
    /// Binding number and name of each buffer.
    bindings: Vec<(u32, String)>,
}

impl Stage {
    /// Compiles all stages of all shaders.
    ///
    /// # Errors
    /// If a shader is not valid WGSL; the message shows where.
    pub fn make_all(
        device: &wgpu::Device,
        options: StageOptions,
        cache: Option<&wgpu::PipelineCache>,
    ) -> Result<Vec<Self>, String> {
        let mut stages = Vec::new();
        for file in SHADER_FILES {
            let (module, info) = file.parse(options.by_subgroups)?;
            let used: Vec<Vec<(u32, String)>> = file
                .entry_points
                .iter()
                .map(|name| used_bindings(&module, &info, name))
                .collect();
            let checks = if options.checked {
                wgpu::ShaderRuntimeChecks::checked()
            } else {
                wgpu::ShaderRuntimeChecks::unchecked()
            };
            let descriptor = wgpu::ShaderModuleDescriptor {
                label: Some(file.name),
                source: wgpu::ShaderSource::Naga(std::borrow::Cow::Owned(module)),
            };
            // SAFETY: the shaders are this crate's own. Their loops end, and every index is below
            // a length that the host allocated: the tests run them with checks and without, and
            // compare the results.
            let shader = unsafe { device.create_shader_module_trusted(descriptor, checks) };
            for (name, bindings) in file.entry_points.iter().zip(used) {
                let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                    label: Some(name),
                    layout: None,
                    module: &shader,
                    entry_point: Some(name),
                    compilation_options: Default::default(),
                    cache,
                });
                stages.push(Self {
                    name,
                    layout: pipeline.get_bind_group_layout(0),
                    pipeline,
                    bindings,
                });
            }
        }
        Ok(stages)
    }

    /// Whether the entry point binds a buffer of that name.
    pub fn uses(&self, buffer: &str) -> bool {
        self.bindings.iter().any(|(_, name)| name == buffer)
    }

    /// A bind group whose buffers are looked up by name.
    ///
    /// # Errors
    /// If the lookup of one fails.
    pub fn bind<'a>(
        &self,
        device: &wgpu::Device,
        buffer: impl Fn(&str) -> Result<&'a wgpu::Buffer, GpuError>,
    ) -> Result<wgpu::BindGroup, GpuError> {
        let bindings = self.bindings.iter();
        let entries: Result<Vec<wgpu::BindGroupEntry<'_>>, GpuError> = bindings
            .map(|(binding, name)| {
                Ok(wgpu::BindGroupEntry {
                    binding: *binding,
                    resource: buffer(name)?.as_entire_binding(),
                })
            })
            .collect();
        Ok(device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(self.name),
            layout: &self.layout,
            entries: &entries?,
        }))
    }
}

/// Binding number and name of each buffer that an entry point uses.
fn used_bindings(
    module: &naga::Module,
    info: &naga::valid::ModuleInfo,
    entry_point: &str,
) -> Vec<(u32, String)> {
    let position = module
        .entry_points
        .iter()
        .position(|entry| entry.name == entry_point);
    let Some(position) = position else {
        return Vec::new();
    };
    let used = info.get_entry_point(position);
    module
        .global_variables
        .iter()
        .filter(|(handle, _)| !used[*handle].is_empty())
        .filter_map(|(_, variable)| Some((variable.binding?.binding, variable.name.clone()?)))
        .collect()
}
