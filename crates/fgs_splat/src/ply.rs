//! Gaussians as PLY files in the layout of the original 3D gaussian splatting, which splat viewers
//! open.
//!
//! Element `vertex` has the float properties `x y z nx ny nz f_dc_0..2 opacity scale_0..2 rot_0..3`:
//! the stored parameters (metres, logits, log-scales, wxyz), so that a file reads back bit for bit.
//! The normal is the gaussian's flat axis, for point-cloud viewers. A last property, uchar `inferred`,
//! is 1 where the gaussian's depth was a guess; files without it have none. Files are written
//! atomically.
//! No file makes the reader panic or take more memory than a small multiple of the file's size,
//! whatever its header says.

use crate::Gaussians;
use ply_rs_bw::parser::{ParseError, Parser, Reader};
use ply_rs_bw::ply::{
    Addable, ElementDef, Encoding, Header, PropertyAccess, PropertyAccessResult, PropertyDef,
    PropertyType, ScalarType,
};
use ply_rs_bw::writer::Writer;
use std::io::{self, BufRead, BufReader, ErrorKind, Write};
use std::path::{Path, PathBuf};
use thiserror::Error;

const PROPERTIES: [&str; 17] = [
    "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1",
    "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
];
/// The normal in [`PROPERTIES`]: the only optional ones.
const NORMAL: std::ops::Range<usize> = 3..6;

/// The only property that is not a float, and optional.
const INFERRED: &str = "inferred";

/// Real headers have some 70 lines. The limit stops a file of another kind from being read as an
/// endless header.
const MAX_HEADER_BYTES: u64 = 1 << 20;

/// Why a PLY file was not read or written.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PlyError {
    /// The file cannot be opened, read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        source: io::Error,
    },
    /// The file is not valid PLY. (Of the parser's message, the first line is enough.)
    #[error("{}: {}", path.display(), source.to_string().lines().next().unwrap_or_default())]
    Parse {
        /// The file.
        path: PathBuf,
        /// The parser's error.
        source: ParseError,
    },
    /// The file ends too early.
    #[error("{}: ends before the last of its {vertices} vertices", path.display())]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Their number according to the header.
        vertices: usize,
    },
    /// The first element is not `vertex`.
    #[error("{}: the first element is {found:?}, not \"vertex\"", path.display())]
    NoVertices {
        /// The file.
        path: PathBuf,
        /// Name of the first element, empty if there is none.
        found: String,
    },
    /// A vertex lacks a property, or it is not a float or double.
    #[error("{}: needs a float property {property:?}", path.display())]
    Property {
        /// The file.
        path: PathBuf,
        /// Its name.
        property: &'static str,
    },
    /// A value is infinite or not a number.
    #[error("{}: {property} of vertex {vertex} is {value}", path.display())]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// Index of the gaussian.
        vertex: usize,
        /// Which property.
        property: &'static str,
        /// Its value.
        value: f32,
    },
}

/// Writes a binary little-endian PLY file atomically.
///
/// # Errors
/// If a parameter is not finite or the file cannot be written; an existing file is then unchanged.
pub fn write_ply(path: &Path, gaussians: &Gaussians) -> Result<(), PlyError> {
    for i in 0..gaussians.len() {
        Vertex::of(gaussians, i).check_finite(path, i)?;
    }
    fgs_files::write_file(path, |file| write(file, gaussians)).map_err(|source| PlyError::Io {
        path: path.to_owned(),
        source,
    })
}

/// Writes what [`write_ply`] does to any writer.
///
/// # Errors
/// [`ErrorKind::InvalidData`] if a parameter is not finite, and what the writer returns.
pub fn encode_ply(writer: &mut impl Write, gaussians: &Gaussians) -> io::Result<()> {
    for vertex in 0..gaussians.len() {
        if let Some((property, value)) = Vertex::of(gaussians, vertex).not_finite() {
            let what = format!("{property} of vertex {vertex} is {value}");
            return Err(io::Error::new(ErrorKind::InvalidData, what));
        }
    }
    write(writer, gaussians)
}

fn write(file: &mut impl Write, gaussians: &Gaussians) -> io::Result<()> {
    let header = header(gaussians.len());
    let writer = Writer::<Vertex>::new();
    writer.write_header(file, &header)?;
    for i in 0..gaussians.len() {
        let vertex = Vertex::of(gaussians, i);
        for element in header.elements.values() {
            writer.write_little_endian_element(file, &vertex, element)?;
        }
    }
    Ok(())
}

/// Reads a PLY file, text or binary, with its properties in any order. Unknown properties, such as
/// higher spherical harmonics, are skipped.
///
/// # Errors
/// If the file cannot be read, is not PLY, does not begin with the vertices, lacks a property, is
/// truncated or holds a value that is not finite.
pub fn read_ply(path: &Path) -> Result<Gaussians, PlyError> {
    let file = fgs_files::open_regular(path).map_err(|source| PlyError::Io {
        path: path.to_owned(),
        source,
    })?;
    read(path, BufReader::new(file))
}

fn read(path: &Path, input: impl BufRead) -> Result<Gaussians, PlyError> {
    let path_buf = || path.to_owned();
    let parser = Parser::<Vertex>::new();
    let mut reader = Reader::new(input.take(MAX_HEADER_BYTES));
    let header = parser
        .read_header(&mut reader)
        .map_err(|source| PlyError::Parse {
            path: path_buf(),
            source,
        })?;
    let element = match header.elements.first() {
        Some((name, element)) if name == "vertex" => element,
        other => {
            return Err(PlyError::NoVertices {
                path: path_buf(),
                found: other.map(|(name, _)| name.clone()).unwrap_or_default(),
            });
        }
    };
    for (slot, property) in PROPERTIES.into_iter().enumerate() {
        let readable = match element.properties.get(property) {
            Some(definition) => matches!(
                definition.data_type,
                PropertyType::Scalar(ScalarType::Float | ScalarType::Double)
            ),
            None => NORMAL.contains(&slot),
        };
        if !readable {
            return Err(PlyError::Property {
                path: path_buf(),
                property,
            });
        }
    }

    reader.get_mut().set_limit(u64::MAX);
    let vertices = parser
        .read_payload_for_element(&mut reader, element, &header)
        .map_err(|source| match source.kind() {
            ErrorKind::UnexpectedEof => PlyError::Truncated {
                path: path_buf(),
                vertices: element.count,
            },
            _ => PlyError::Parse {
                path: path_buf(),
                source,
            },
        })?;
    let mut gaussians = Gaussians::default();
    for (i, vertex) in vertices.iter().enumerate() {
        vertex.check_finite(path, i)?;
        vertex.push_to(&mut gaussians);
    }
    Ok(gaussians)
}

fn header(vertices: usize) -> Header {
    let mut element = ElementDef::new("vertex".to_owned());
    element.count = vertices;
    for name in PROPERTIES {
        let float = PropertyType::Scalar(ScalarType::Float);
        element
            .properties
            .add(PropertyDef::new(name.to_owned(), float));
    }
    let inferred = PropertyType::Scalar(ScalarType::UChar);
    element
        .properties
        .add(PropertyDef::new(INFERRED.to_owned(), inferred));
    let mut header = Header::new();
    header.encoding = Encoding::BinaryLittleEndian;
    header.elements.add(element);
    header
}

#[derive(Clone, Copy)]
struct Vertex {
    /// In the order of [`PROPERTIES`].
    values: [f32; PROPERTIES.len()],
    inferred: bool,
}

impl Vertex {
    fn of(gaussians: &Gaussians, i: usize) -> Self {
        let [x, y, z] = gaussians.means[i];
        let [nx, ny, nz] = flat_axis(gaussians.quats[i]);
        let [red, green, blue] = gaussians.sh[i];
        let opacity = gaussians.opacity_logits[i];
        let [s0, s1, s2] = gaussians.log_scales[i];
        let [qw, qx, qy, qz] = gaussians.quats[i];
        Self {
            values: [
                x, y, z, nx, ny, nz, red, green, blue, opacity, s0, s1, s2, qw, qx, qy, qz,
            ],
            inferred: gaussians.inferred[i],
        }
    }

    fn push_to(&self, gaussians: &mut Gaussians) {
        let [
            x,
            y,
            z,
            _,
            _,
            _,
            red,
            green,
            blue,
            opacity,
            s0,
            s1,
            s2,
            qw,
            qx,
            qy,
            qz,
        ] = self.values;
        gaussians.means.push([x, y, z]);
        gaussians.sh.push([red, green, blue]);
        gaussians.opacity_logits.push(opacity);
        gaussians.log_scales.push([s0, s1, s2]);
        gaussians.quats.push([qw, qx, qy, qz]);
        gaussians.inferred.push(self.inferred);
    }

    fn check_finite(&self, path: &Path, vertex: usize) -> Result<(), PlyError> {
        match self.not_finite() {
            None => Ok(()),
            Some((property, value)) => Err(PlyError::NotFinite {
                path: path.to_owned(),
                vertex,
                property,
                value,
            }),
        }
    }

    /// The first value that is not finite, normals apart, with its name.
    fn not_finite(&self) -> Option<(&'static str, f32)> {
        let values = PROPERTIES.into_iter().zip(self.values).enumerate();
        let mut stored = values.filter(|(slot, _)| !NORMAL.contains(slot));
        stored.find_map(|(_, (property, value))| (!value.is_finite()).then_some((property, value)))
    }
}

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self {
            values: [0.0; PROPERTIES.len()],
            inferred: false,
        }
    }

    fn set_float(&mut self, name: &str, value: f32) -> PropertyAccessResult {
        match PROPERTIES.iter().position(|property| *property == name) {
            Some(slot) => {
                self.values[slot] = value;
                PropertyAccessResult::Set
            }
            None => PropertyAccessResult::Ignored,
        }
    }

    fn set_double(&mut self, name: &str, value: f64) -> PropertyAccessResult {
        self.set_float(name, value as f32)
    }

    fn get_float(&self, name: &str) -> Option<f32> {
        let slot = PROPERTIES.iter().position(|property| *property == name)?;
        Some(self.values[slot])
    }

    fn set_uchar(&mut self, name: &str, value: u8) -> PropertyAccessResult {
        if name != INFERRED {
            return PropertyAccessResult::Ignored;
        }
        self.inferred = value != 0;
        PropertyAccessResult::Set
    }

    fn get_uchar(&self, name: &str) -> Option<u8> {
        (name == INFERRED).then_some(self.inferred.into())
    }
}

/// The gaussian's third axis in the world; zero if the quaternion is zero.
fn flat_axis([w, x, y, z]: [f32; 4]) -> [f32; 3] {
    let axis = [
        2.0 * (x * z + w * y),
        2.0 * (y * z - w * x),
        w * w + z * z - x * x - y * y,
    ];
    let length = axis.iter().map(|a| a * a).sum::<f32>().sqrt();
    if length > 0.0 && length.is_finite() {
        axis.map(|a| a / length)
    } else {
        [0.0; 3]
    }
}

#[cfg(test)]
mod tests;
