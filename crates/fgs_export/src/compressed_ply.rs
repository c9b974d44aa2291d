//! Gaussians as the compressed PLY file of PlayCanvas and SuperSplat.
//!
//! Gaussians near each other form chunks of 256. Element `chunk` has the bounds of each chunk's
//! positions, log-scales and colours; element `vertex` has four 32-bit words a gaussian, which place it
//! within these bounds: positions and log-scales by 11, 10 and 11 bits, colours and opacity by 8 each,
//! the rotation by the place of its largest component (2 bits) and the others (10 bits each). The run's
//! axes, y down; metres.

use std::io::{self, Write};

use fgs_splat::Gaussians;

use crate::ply::{Element, write_floats, write_header};
use crate::quantities::{byte, index_of_largest, unit_quat};

const CHUNK: usize = 256;

const CHUNK_PROPERTIES: [(&str, &str); 18] = [
    ("float", "min_x"),
    ("float", "min_y"),
    ("float", "min_z"),
    ("float", "max_x"),
    ("float", "max_y"),
    ("float", "max_z"),
    ("float", "min_scale_x"),
    ("float", "min_scale_y"),
    ("float", "min_scale_z"),
    ("float", "max_scale_x"),
    ("float", "max_scale_y"),
    ("float", "max_scale_z"),
    ("float", "min_r"),
    ("float", "min_g"),
    ("float", "min_b"),
    ("float", "max_r"),
    ("float", "max_g"),
    ("float", "max_b"),
];

const VERTEX_PROPERTIES: [(&str, &str); 4] = [
    ("uint", "packed_position"),
    ("uint", "packed_rotation"),
    ("uint", "packed_scale"),
    ("uint", "packed_color"),
];

/// Far outside of what can be seen; a single absurd value would otherwise spoil its chunk.
const MAX_LOG_SCALE: f32 = 20.0;

/// Writes all gaussians, ordered along a space-filling curve.
///
/// # Errors
/// If writing fails.
pub fn write_compressed_ply(out: &mut impl Write, gaussians: &Gaussians) -> io::Result<()> {
    let order = morton_order(&gaussians.means);
    let chunks: Vec<Chunk> = order
        .chunks(CHUNK)
        .map(|members| Chunk::new(gaussians, members))
        .collect();
    let elements = [
        Element {
            name: "chunk",
            count: chunks.len(),
            properties: &CHUNK_PROPERTIES,
        },
        Element {
            name: "vertex",
            count: gaussians.len(),
            properties: &VERTEX_PROPERTIES,
        },
    ];
    write_header(out, &elements)?;
    for chunk in &chunks {
        for bounds in [&chunk.positions, &chunk.log_scales, &chunk.colors] {
            write_floats(out, &bounds.min)?;
            write_floats(out, &bounds.max)?;
        }
    }
    for (members, chunk) in order.chunks(CHUNK).zip(&chunks) {
        for &i in members {
            for word in chunk.packed(gaussians, i) {
                out.write_all(&word.to_le_bytes())?;
            }
        }
    }
    Ok(())
}

struct Chunk {
    positions: Bounds,
    log_scales: Bounds,
    colors: Bounds,
}

impl Chunk {
    fn new(gaussians: &Gaussians, members: &[usize]) -> Self {
        let members = members.iter();
        Self {
            positions: Bounds::of(members.clone().map(|&i| gaussians.means[i])),
            log_scales: Bounds::of(members.clone().map(|&i| log_scales(gaussians, i))),
            colors: Bounds::of(members.map(|&i| gaussians.rgb(i))),
        }
    }

    /// Position, rotation, scale and colour of gaussian i.
    fn packed(&self, gaussians: &Gaussians, i: usize) -> [u32; 4] {
        let [red, green, blue] = self.colors.within(gaussians.rgb(i)).map(byte);
        // Neither 0 nor 1, of which readers take the logit.
        let opacity = byte(gaussians.opacity(i)).clamp(1, 254);
        [
            packed_11_10_11(self.positions.within(gaussians.means[i])),
            packed_rotation(unit_quat(gaussians, i)),
            packed_11_10_11(self.log_scales.within(log_scales(gaussians, i))),
            u32::from_be_bytes([red, green, blue, opacity]),
        ]
    }
}

fn log_scales(gaussians: &Gaussians, i: usize) -> [f32; 3] {
    gaussians.log_scales[i].map(|scale| scale.clamp(-MAX_LOG_SCALE, MAX_LOG_SCALE))
}

/// The smallest and largest values, component by component.
struct Bounds {
    min: [f32; 3],
    max: [f32; 3],
}

impl Bounds {
    fn of(values: impl Iterator<Item = [f32; 3]>) -> Self {
        let mut bounds = Self {
            min: [f32::INFINITY; 3],
            max: [f32::NEG_INFINITY; 3],
        };
        for value in values {
            for (axis, value) in value.into_iter().enumerate() {
                bounds.min[axis] = bounds.min[axis].min(value);
                bounds.max[axis] = bounds.max[axis].max(value);
            }
        }
        bounds
    }

    /// Where a value lies between the bounds, 0 to 1; 0 if they are equal.
    fn within(&self, value: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|axis| {
            let (min, max) = (self.min[axis], self.max[axis]);
            if max > min {
                // Halved, so that the difference cannot overflow.
                (0.5 * value[axis] - 0.5 * min) / (0.5 * max - 0.5 * min)
            } else {
                0.0
            }
        })
    }
}

/// 0 to 1 as an integer of so many bits.
fn quantized(value: f32, bits: u32) -> u32 {
    let max = (1 << bits) - 1;
    ((value * max as f32).round() as u32).min(max)
}

fn packed_11_10_11([x, y, z]: [f32; 3]) -> u32 {
    quantized(x, 11) << 21 | quantized(y, 10) << 11 | quantized(z, 11)
}

fn packed_rotation(quat: [f32; 4]) -> u32 {
    let largest = index_of_largest(&quat);
    let sign = quat[largest].signum();
    let others = (0..4).filter(|i| *i != largest);
    others.fold(largest as u32, |packed, i| {
        let q = sign * quat[i] * std::f32::consts::FRAC_1_SQRT_2 + 0.5;
        packed << 10 | quantized(q, 10)
    })
}

/// The indices of the points along a Morton curve through their bounding box.
fn morton_order(means: &[[f32; 3]]) -> Vec<usize> {
    const BITS: u32 = 21;
    let bounds = Bounds::of(means.iter().copied());
    let code = |mean: [f32; 3]| {
        let cell = bounds.within(mean).map(|x| quantized(x, BITS));
        (0..BITS).rev().fold(0_u64, |code, bit| {
            let digit = |axis: usize| u64::from(cell[axis] >> bit & 1);
            code << 3 | digit(2) << 2 | digit(1) << 1 | digit(0)
        })
    };
    let codes: Vec<u64> = means.iter().copied().map(code).collect();
    let mut order: Vec<usize> = (0..means.len()).collect();
    order.sort_by_key(|i| codes[*i]);
    order
}
