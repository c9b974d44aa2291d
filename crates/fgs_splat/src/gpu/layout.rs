//! What Rust and the shaders must agree on: constants, struct layouts, and indices into small arrays.
//! Each is defined once, here or in the CPU's code, and the shaders' preamble is generated from it. A
//! test compares the structs' sizes and offsets with those of the shader compiler.

use std::fmt::Write;

use bytemuck::{Pod, Zeroable};

use crate::adam::{BETA_1, BETA_2, DECAY_STEPS, EPSILON};
use crate::contradicted::{FADE_LOGIT, FAR_IN_FRONT, HIDDEN_LOGIT, IN_FRONT, WIDE_PX};
use crate::cpu::{SLACK_PX, WHITEN_SCALE};
use crate::gaussians::SH0_FACTOR;
use crate::losses::{C1, C2, FLAT_SCALE_M, MAX_LOG_SCALE, MAX_RENDERED, MIN_ALPHA, RADIUS};
use crate::rendering::{
    ALPHA_MAX, ALPHA_MIN, LOW_PASS_PX2, MAX_MAGNITUDE, MAX_VARIANCE_PX2, MIN_QUAT_NORM2, NEAR_M,
    PLANE_MIN_COS, TRANSMITTANCE_MIN,
};

/// Workgroup size of most stages, threads. `forward` and `backward` have one per pixel of a tile.
pub const GROUP: u32 = 256;
/// Keys per workgroup of the radix sort.
pub const SORT_BLOCK: u32 = 2048;
/// Side of a tile, pixels. Small, since most gaussians are a few pixels wide and every pixel of a
/// tile evaluates all of the tile's gaussians.
pub const TILE: u32 = 8;
/// Side of the pixel block of a loss workgroup.
pub const LOSS_SIDE: u32 = 16;
/// Vectors of 16 bytes that a thread copies when bandwidth is measured.
pub const COPIED_ROWS: u32 = 4;
/// Rounds of 32 multiply-adds when arithmetic throughput is measured.
pub const MULTIPLY_ADD_ROUNDS: u32 = 256;
/// Stands for no gaussian, visibility set, anchor or sparse id.
pub const NONE: u32 = u32::MAX;

/// Stands for a sparse id: not part of the sparse map, and its depth is a guess.
pub const INFERRED: u32 = u32::MAX - 1;

/// A type of struct fields, with its name in WGSL.
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

/// A struct's name and size, and the names and offsets of its fields, as Rust lays it out; bytes.
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
    /// A camera, and the sizes of what it renders. Scalars fill the padding of the vectors.
    struct View {
        /// First row of the rotation `camera_from_world`.
        row_x: [f32; 3],
        /// Pixels.
        width: u32,
        row_y: [f32; 3],
        height: u32,
        row_z: [f32; 3],
        /// Number of gaussians.
        count: u32,
        /// The camera's position in the world, metres.
        position: [f32; 3],
        /// Capacity of the tile lists, entries.
        capacity: u32,
        /// Focal lengths and principal point, pixels.
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
        /// First word of the view's set in `visible_sets`, or `NONE`.
        set_start: u32,
        padding_0: u32,
        padding_1: [f32; 2],
    }

    /// A gaussian's stored parameters, step count and sparse id.
    struct Gaussian {
        mean: [f32; 3],
        opacity_logit: f32,
        quat: [f32; 4],
        log_scales: [f32; 3],
        /// Adam steps taken.
        steps: u32,
        sh: [f32; 3],
        /// `NONE` or `INFERRED` if it is not part of the sparse map.
        sparse_id: u32,
    }

    /// The loss's derivatives with respect to a gaussian's stored parameters.
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
        /// After the last gaussian.
        transmittance: f32,
        /// Length of the tile's list up to the last entry that contributed.
        used: u32,
    }

    /// One pass of a radix sort.
    struct SortPass {
        /// Lowest bit of the digit.
        shift: u32,
        /// Index into `counts` of the number of keys.
        count: u32,
    }

    /// Weights of the loss's terms, divided by the number of values that each averages.
    struct Loss {
        l1: f32,
        ssim: f32,
        depth: f32,
        /// Not divided: the number of touched gaussians is known on the device only.
        scale: f32,
        /// 1 if colour is compared only where depth was measured.
        masked: u32,
        /// 1 if the rendered depth is divided by alpha.
        normalize_depth: u32,
        /// Columns and rows of workgroups.
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

    /// A pruning rule; see `PruneRule`.
    struct Prune {
        /// Number of gaussians.
        count: u32,
        /// Words of each visibility set.
        set_words: u32,
        min_opacity: f32,
        /// Of the longest axis; the scale is in metres.
        max_log_scale: f32,
        /// Logarithm of the largest ratio of the longest axis to the middle one.
        max_log_aspect: f32,
    }

    /// The rigid motion of the gaussians anchored to a keyframe.
    struct Motion {
        /// First row of the rotation.
        row_x: [f32; 3],
        /// Id of the keyframe.
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

    /// The parameters of `see_through`.
    struct SeeThrough {
        /// Pixels with a lower alpha are marked.
        min_alpha: f32,
        /// Number of pixels.
        pixels: u32,
    }

    /// A view's visibility set, to be compared with all sets.
    struct Covisibility {
        own_set: u32,
        /// Words of each set.
        set_words: u32,
        /// Words of each set that belong to existing gaussians.
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
            /// All of them in order, with their names.
            pub const ALL: &[(Self, &'static str)] = &[$((Self::$name, stringify!($name))),*];
        }
    };
}

places! {
    /// Indices into `counts`, a step's counts and flags.
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
    /// Indices into `dispatches`, the sizes of indirect dispatches.
    Dispatch {
        PER_VISIBLE,
        SORT_VISIBLE,
        SORT_ENTRIES,
    }
}

/// Words of an indirect dispatch: workgroups along x, y and z.
pub const DISPATCH_WORDS: u32 = 3;

/// The WGSL preamble of every shader: constants and structs.
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
        ("IN_FRONT", IN_FRONT.into()),
        ("FAR_IN_FRONT", FAR_IN_FRONT.into()),
        ("WIDE_PX", WIDE_PX.into()),
        ("FADE_LOGIT", FADE_LOGIT.into()),
        ("HIDDEN_LOGIT", HIDDEN_LOGIT.into()),
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
        ("INFERRED", INFERRED),
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
