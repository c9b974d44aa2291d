//! What Rust and the shaders must agree on: constants, struct layouts, and indices into small arrays.
//! Each is defined once, here or in the CPU's code, and the shaders' preamble is generated from it; a
//! test compares the offsets with those of the shader compiler.

use std::fmt::Write;

use bytemuck::{Pod, Zeroable};

use crate::adam::{BETA_1, BETA_2, DECAY_STEPS, EPSILON};
use crate::cpu::{SLACK_PX, WHITEN_SCALE};
use crate::gaussians::SH0_FACTOR;
use crate::losses::{C1, C2, FLAT_SCALE_M, MAX_LOG_SCALE, MAX_RENDERED, MIN_ALPHA, RADIUS};
use crate::rendering::{
    ALPHA_MAX, ALPHA_MIN, LOW_PASS_PX2, MAX_MAGNITUDE, MAX_VARIANCE_PX2, MIN_QUAT_NORM2, NEAR_M,
    PLANE_MIN_COS, TRANSMITTANCE_MIN,
};

/// Threads of a workgroup over gaussians, keys or pixels of the loss.
pub const GROUP: u32 = 256;
/// Keys that one workgroup sorts.
pub const SORT_BLOCK: u32 = 2048;
/// Side of a tile, pixels. Small, since most gaussians are a few pixels wide and every pixel of a
/// tile evaluates all of the tile's gaussians.
pub const TILE: u32 = 8;
/// Side of the loss's workgroups, pixels.
pub const LOSS_SIDE: u32 = 16;
/// Rows of 16 bytes that a thread copies when bandwidth is measured.
pub const COPIED_ROWS: u32 = 4;
/// Rounds of 32 multiply-adds when arithmetic throughput is measured.
pub const MULTIPLY_ADD_ROUNDS: u32 = 256;
/// No gaussian, no set, no name.
pub const NONE: u32 = u32::MAX;

/// A type that struct fields may have.
trait DeviceType {
    const WGSL: &'static str;
}

impl DeviceType for f32 {
    const WGSL: &'static str = "f32";
}
impl DeviceType for u32 {
    const WGSL: &'static str = "u32";
}
impl DeviceType for [f32; 2] {
    const WGSL: &'static str = "vec2<f32>";
}
impl DeviceType for [f32; 3] {
    const WGSL: &'static str = "vec3<f32>";
}
impl DeviceType for [f32; 4] {
    const WGSL: &'static str = "vec4<f32>";
}

/// A structure's name, size, and the names and offsets of its fields, as Rust lays it out.
#[cfg(test)]
pub type Layout = (&'static str, usize, Vec<(&'static str, usize)>);

macro_rules! device_structs {
    ($($(#[$doc:meta])* struct $name:ident { $($(#[$field_doc:meta])* $field:ident: $type:ty,)* })*) => {
        $(
            $(#[$doc])*
            #[repr(C)]
            #[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
            pub struct $name { $($(#[$field_doc])* pub $field: $type,)* }
        )*

        fn write_structs(source: &mut String) {
            $(
                source.push_str(concat!("struct ", stringify!($name), " {\n"));
                $(
                    let wgsl = <$type as DeviceType>::WGSL;
                    let _ = writeln!(source, "    {}: {wgsl},", stringify!($field));
                )*
                source.push_str("}\n");
            )*
        }

        #[cfg(test)]
        pub fn layouts() -> Vec<Layout> {
            vec![$((
                stringify!($name),
                size_of::<$name>(),
                vec![$((stringify!($field), std::mem::offset_of!($name, $field))),*],
            )),*]
        }
    };
}

device_structs! {
    /// A view and the sizes of what is rendered for it.
    struct View {
        /// Rows of the rotation `camera_from_world`, each padded by a scalar.
        row_x: [f32; 3],
        /// Pixels.
        width: u32,
        row_y: [f32; 3],
        height: u32,
        row_z: [f32; 3],
        /// Number of gaussians.
        count: u32,
        /// The camera in the world, metres.
        position: [f32; 3],
        /// Capacity of the tile lists, entries.
        capacity: u32,
        /// Pixels.
        focal: [f32; 2],
        center: [f32; 2],
        /// See `ScreenCamera`.
        tangent_min: [f32; 2],
        tangent_max: [f32; 2],
        /// See `Frustum`.
        frustum_middle: [f32; 2],
        frustum_half: [f32; 2],
        frustum_reach: [f32; 2],
        tile_columns: u32,
        tile_rows: u32,
        /// The word where the view's set of visible gaussians starts, or `NONE`.
        set_start: u32,
        padding_0: u32,
        padding_1: [f32; 2],
    }

    /// A gaussian's stored parameters, its step count and its name in the sparse map.
    struct Gaussian {
        mean: [f32; 3],
        opacity_logit: f32,
        quat: [f32; 4],
        log_scales: [f32; 3],
        /// Adam steps taken.
        steps: u32,
        sh: [f32; 3],
        /// `NONE` if it is not part of the sparse map.
        sparse_id: u32,
    }

    /// The loss's derivatives by a gaussian's parameters.
    struct Gradient {
        mean: [f32; 3],
        opacity_logit: f32,
        quat: [f32; 4],
        log_scales: [f32; 3],
        /// 1 if the gaussian contributed to a pixel; otherwise the rest is undefined.
        touched: u32,
        sh: [f32; 3],
        padding: u32,
    }

    /// A projected gaussian; see `cpu::project::Splat`.
    struct Splat {
        mean2d: [f32; 2],
        whiten_xx: f32,
        whiten_xy: f32,
        whiten_yy: f32,
        opacity: f32,
        center_depth: f32,
        plane_offset: f32,
        color: [f32; 3],
        padding_0: u32,
        plane: [f32; 3],
        padding_1: u32,
    }

    /// A pixel's state for the backward pass.
    struct PixelState {
        /// Behind the last gaussian.
        transmittance: f32,
        /// How many entries of the tile's list there are up to and including the last that contributed.
        used: u32,
    }

    /// One pass of a radix sort.
    struct SortPass {
        /// The digit's lowest bit.
        shift: u32,
        /// Index of the number of keys in the counts.
        count: u32,
    }

    /// Weights of the loss terms, each divided by the number of values averaged.
    struct Loss {
        l1: f32,
        ssim: f32,
        depth: f32,
        /// Not divided.
        scale: f32,
        /// 1 if colour is compared only where depth was measured.
        masked: u32,
        /// 1 if the rendered depth is divided by alpha.
        normalize_depth: u32,
        /// Workgroups along each side of the image.
        columns: u32,
        rows: u32,
    }

    /// The learning rates, and the weight of the regulariser.
    struct Optimizer {
        means: f32,
        quats: f32,
        log_scales: f32,
        opacity_logits: f32,
        sh: f32,
        scale_weight: f32,
    }

    /// The pruning rule; see `PruneRule`.
    struct Prune {
        /// Number of gaussians.
        count: u32,
        /// Words of each set of gaussians.
        set_words: u32,
        min_opacity: f32,
        /// Logarithm of metres.
        max_log_scale: f32,
        /// Logarithm of the ratio of the two longer axes.
        max_log_aspect: f32,
    }

    /// The rigid motion of the gaussians anchored to a keyframe.
    struct Motion {
        /// Rows of the rotation.
        row_x: [f32; 3],
        anchor: u32,
        row_y: [f32; 3],
        padding_0: u32,
        row_z: [f32; 3],
        padding_1: u32,
        /// Metres.
        translation: [f32; 3],
        padding_2: u32,
        /// The rotation as a quaternion, wxyz.
        quat: [f32; 4],
    }

    /// The rule of `see_through`.
    struct SeeThrough {
        /// Pixels with a lower alpha are seen through.
        min_alpha: f32,
        /// Number of pixels.
        pixels: u32,
    }

    /// A view's set, to be compared with all others.
    struct Covisibility {
        own_set: u32,
        /// Words of each set, and how many of them are in use.
        set_words: u32,
        used_words: u32,
    }
}

macro_rules! places {
    ($(#[$doc:meta])* $kind:ident { $($name:ident,)* }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[allow(clippy::upper_case_acronyms, non_camel_case_types)]
        pub enum $kind { $($name,)* }

        impl $kind {
            /// All of them, in order.
            pub const ALL: &[(Self, &'static str)] = &[$((Self::$name, stringify!($name))),*];
        }
    };
}

places! {
    /// Indices into the counts of a step.
    Count {
        VISIBLE,
        ENTRIES,
        ENTRIES_NEEDED,
        OVERFLOWED,
        OUT_OF_RANGE,
        TOUCHED,
        SKIPPED,
        LOSS,
        KEPT,
    }
}

places! {
    /// Indirect dispatches, three words each.
    Dispatch {
        PER_VISIBLE,
        SORT_VISIBLE,
        SORT_ENTRIES,
    }
}

/// Words of an indirect dispatch.
pub const DISPATCH_WORDS: u32 = 3;

/// The preamble of every shader.
pub fn preamble() -> String {
    let mut source = String::new();
    for (name, value) in [
        ("ALPHA_MIN", ALPHA_MIN),
        ("ALPHA_MAX", ALPHA_MAX),
        ("TRANSMITTANCE_MIN", TRANSMITTANCE_MIN),
        ("LOW_PASS_PX2", LOW_PASS_PX2),
        ("NEAR_M", NEAR_M),
        ("PLANE_MIN_COS", PLANE_MIN_COS),
        ("MAX_MAGNITUDE", MAX_MAGNITUDE),
        ("MAX_VARIANCE_PX2", MAX_VARIANCE_PX2),
        ("MIN_QUAT_NORM2", MIN_QUAT_NORM2),
        ("WHITEN_SCALE", WHITEN_SCALE),
        ("SLACK_PX", SLACK_PX),
        ("SH0_FACTOR", SH0_FACTOR),
        ("C1", C1.into()),
        ("C2", C2.into()),
        ("MIN_ALPHA", MIN_ALPHA.into()),
        ("MAX_RENDERED", MAX_RENDERED.into()),
        ("MAX_LOG_SCALE", MAX_LOG_SCALE.into()),
        ("FLAT_SCALE_M", FLAT_SCALE_M.into()),
        ("BETA_1", BETA_1),
        ("BETA_2", BETA_2),
        ("DECAY_STEPS", DECAY_STEPS),
        ("EPSILON", EPSILON.into()),
    ] {
        let _ = writeln!(source, "const {name}: f32 = {:?};", value as f32);
    }
    for (name, value) in [
        ("GROUP", GROUP),
        ("SORT_BLOCK", SORT_BLOCK),
        ("TILE_PIXELS", TILE * TILE),
        ("SIDE", LOSS_SIDE),
        ("RADIUS", RADIUS as u32),
        ("NONE", NONE),
        ("MAX_STEPS", u32::MAX - 1),
        ("COPIED_ROWS", COPIED_ROWS),
        ("MULTIPLY_ADD_ROUNDS", MULTIPLY_ADD_ROUNDS),
    ] {
        let _ = writeln!(source, "const {name}: u32 = {value}u;");
    }
    let _ = writeln!(source, "const TILE: i32 = {TILE};");
    for (place, name) in Count::ALL {
        let _ = writeln!(source, "const {name}: u32 = {}u;", *place as u32);
    }
    for (place, name) in Dispatch::ALL {
        let first = DISPATCH_WORDS * *place as u32;
        let _ = writeln!(source, "const {name}: u32 = {first}u;");
    }
    write_structs(&mut source);
    source
}
