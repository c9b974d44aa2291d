//! All shaders are valid, and structs have the same layout in Rust and in WGSL. Needs no device.

use naga::back::{hlsl, msl};

use crate::gpu::device::{STORAGE_BUFFERS, WORKGROUP_BYTES, WORKGROUP_THREADS};
use crate::gpu::layout::layouts;
use crate::gpu::stage::SHADER_FILES;

#[test]
fn every_shader_is_valid_with_subgroup_operations_and_without() {
    for file in SHADER_FILES {
        for by_subgroups in [false, true] {
            if let Err(message) = file.parse(by_subgroups) {
                panic!("{message}");
            }
        }
    }
}

#[test]
fn structures_lie_as_the_shaders_have_them() {
    let mut compared = 0;
    for file in SHADER_FILES {
        let (module, _) = file.parse(false).unwrap();
        let mut layouter = naga::proc::Layouter::default();
        layouter.update(module.to_ctx()).unwrap();
        for (name, size, fields) in layouts() {
            let found = module
                .types
                .iter()
                .find(|(_, ty)| ty.name.as_deref() == Some(name));
            let Some((handle, ty)) = found else {
                continue;
            };
            let naga::TypeInner::Struct { members, .. } = &ty.inner else {
                panic!("{name} is no structure");
            };
            let offsets: Vec<(&str, usize)> = members
                .iter()
                .map(|member| (member.name.as_deref().unwrap(), member.offset as usize))
                .collect();
            assert_eq!(offsets, fields, "{name}");
            assert_eq!(layouter[handle].size as usize, size, "{name}");
            compared += 1;
        }
    }
    assert!(compared >= layouts().len());
}

/// Drivers may spill constant arrays that a loop counter indexes to thread-local memory.
#[test]
fn no_shader_has_a_constant_array() {
    for file in SHADER_FILES {
        let (module, _) = file.parse(false).unwrap();
        for (_, constant) in module.constants.iter() {
            let is_array = matches!(
                module.types[constant.ty].inner,
                naga::TypeInner::Array { .. }
            );
            assert!(!is_array, "{}: {:?}", file.name, constant.name);
        }
    }
}

#[test]
fn metal_and_direct_x_have_words_for_every_shader() {
    for file in SHADER_FILES {
        for by_subgroups in [false, true] {
            let (module, info) = file.parse(by_subgroups).unwrap();
            let options = msl::Options {
                lang_version: (2, 4),
                fake_missing_bindings: true,
                ..msl::Options::default()
            };
            let metal = msl::write_string(&module, &info, &options, &Default::default());
            assert!(metal.is_ok(), "{}: {metal:?}", file.name);

            let options = hlsl::Options {
                shader_model: hlsl::ShaderModel::V6_0,
                fake_missing_bindings: true,
                ..hlsl::Options::default()
            };
            let mut text = String::new();
            let pipeline_options = hlsl::PipelineOptions::default();
            let written = hlsl::Writer::new(&mut text, &options, &pipeline_options)
                .write(&module, &info, None);
            assert!(written.is_ok(), "{}: {written:?}", file.name);
        }
    }
}

#[test]
fn no_stage_needs_more_than_devices_are_asked_for() {
    let mut most_buffers = 0;
    for file in SHADER_FILES {
        for by_subgroups in [false, true] {
            let (module, info) = file.parse(by_subgroups).unwrap();
            let mut layouter = naga::proc::Layouter::default();
            layouter.update(module.to_ctx()).unwrap();
            for (number, stage) in module.entry_points.iter().enumerate() {
                let used = info.get_entry_point(number);
                let (mut buffers, mut bytes) = (0, 0);
                for (handle, variable) in module.global_variables.iter() {
                    if used[handle].is_empty() {
                        continue;
                    }
                    match variable.space {
                        naga::AddressSpace::Storage { .. } => buffers += 1,
                        naga::AddressSpace::WorkGroup => {
                            bytes += layouter[variable.ty].size.next_multiple_of(16);
                        }
                        _ => {}
                    }
                }
                let threads: u32 = stage.workgroup_size.iter().product();
                assert!(threads <= WORKGROUP_THREADS, "{}: {threads}", stage.name);
                assert!(bytes <= WORKGROUP_BYTES, "{}: {bytes}", stage.name);
                most_buffers = most_buffers.max(buffers);
            }
        }
    }
    assert_eq!(most_buffers, STORAGE_BUFFERS);
}
