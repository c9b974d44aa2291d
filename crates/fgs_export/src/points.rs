//! The map's measured surface as coloured points.

use std::io::{self, Write};

use fgs_splat::Gaussians;

use crate::ply::{Element, write_floats, write_header};
use crate::quantities::{byte, is_surface};

const PROPERTIES: [(&str, &str); 6] = [
    ("float", "x"),
    ("float", "y"),
    ("float", "z"),
    ("uchar", "red"),
    ("uchar", "green"),
    ("uchar", "blue"),
];

/// A point on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// World of the run, metres.
    pub position: [f32; 3],
    /// sRGB.
    pub color: [u8; 3],
}

/// The centres of the gaussians that are opaque (at least one half) and stand where depth was measured,
/// not inferred.
pub fn surface_points(gaussians: &Gaussians) -> Vec<Point> {
    let is_surface = |i: &usize| is_surface(gaussians, *i);
    let point = |i: usize| Point {
        position: gaussians.means[i],
        color: gaussians.rgb(i).map(byte),
    };
    (0..gaussians.len()).filter(is_surface).map(point).collect()
}

/// Writes points as a PLY file: `x y z` (float, metres, the run's axes) and `red green blue` (uchar).
///
/// # Errors
/// If writing fails.
pub fn write_points(out: &mut impl Write, points: &[Point]) -> io::Result<()> {
    let vertices = Element {
        name: "vertex",
        count: points.len(),
        properties: &PROPERTIES,
    };
    write_header(out, &[vertices])?;
    for point in points {
        write_floats(out, &point.position)?;
        out.write_all(&point.color)?;
    }
    Ok(())
}
