//! The header of binary PLY files; rows follow as plain little-endian values.

use std::io::{self, Write};

/// An element of a PLY file.
pub(crate) struct Element<'a> {
    pub name: &'a str,
    /// Number of rows.
    pub count: usize,
    /// Type and name of each property, in the order of a row's values.
    pub properties: &'a [(&'a str, &'a str)],
}

/// Writes the header; the elements' rows have to follow in the same order.
///
/// # Errors
/// If writing fails.
pub(crate) fn write_header(out: &mut impl Write, elements: &[Element]) -> io::Result<()> {
    writeln!(out, "ply\nformat binary_little_endian 1.0")?;
    for element in elements {
        writeln!(out, "element {} {}", element.name, element.count)?;
        for (kind, name) in element.properties {
            writeln!(out, "property {kind} {name}")?;
        }
    }
    writeln!(out, "end_header")
}

/// Writes little-endian floats.
///
/// # Errors
/// If writing fails.
pub(crate) fn write_floats(out: &mut impl Write, values: &[f32]) -> io::Result<()> {
    values
        .iter()
        .try_for_each(|value| out.write_all(&value.to_le_bytes()))
}
