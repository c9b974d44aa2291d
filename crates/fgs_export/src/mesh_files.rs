//! Meshes as PLY, OBJ and binary glTF.

use std::io::{self, Write};

use serde_json::json;

use crate::Mesh;
use crate::glb::Glb;
use crate::ply::{Element, write_floats, write_header};
use crate::quantities::{byte, linear, y_up};

const TRIANGLES: u32 = 4;

const VERTEX_PROPERTIES: [(&str, &str); 9] = [
    ("float", "x"),
    ("float", "y"),
    ("float", "z"),
    ("float", "nx"),
    ("float", "ny"),
    ("float", "nz"),
    ("uchar", "red"),
    ("uchar", "green"),
    ("uchar", "blue"),
];

/// Writes a PLY file: vertices `x y z nx ny nz` (float, metres, the run's axes), `red green blue`
/// (uchar, sRGB); faces `vertex_indices`.
///
/// # Errors
/// If writing fails.
pub fn write_mesh_ply(out: &mut impl Write, mesh: &Mesh) -> io::Result<()> {
    let elements = [
        Element {
            name: "vertex",
            count: mesh.positions.len(),
            properties: &VERTEX_PROPERTIES,
        },
        Element {
            name: "face",
            count: mesh.triangles.len(),
            properties: &[("list uchar uint", "vertex_indices")],
        },
    ];
    write_header(out, &elements)?;
    for ((position, normal), color) in mesh.positions.iter().zip(&mesh.normals).zip(&mesh.colors) {
        write_floats(out, position)?;
        write_floats(out, normal)?;
        out.write_all(&color.map(byte))?;
    }
    for triangle in &mesh.triangles {
        out.write_all(&[3])?;
        for vertex in triangle {
            out.write_all(&vertex.to_le_bytes())?;
        }
    }
    Ok(())
}

/// Writes an OBJ file: `v x y z r g b` (metres, the run's axes; colours behind the coordinates are
/// widely read), normals, faces.
///
/// # Errors
/// If writing fails.
pub fn write_mesh_obj(out: &mut impl Write, mesh: &Mesh) -> io::Result<()> {
    writeln!(
        out,
        "# metres; x right, y down, z forward from the first camera"
    )?;
    for ([x, y, z], [red, green, blue]) in mesh.positions.iter().zip(&mesh.colors) {
        writeln!(out, "v {x} {y} {z} {red:.4} {green:.4} {blue:.4}")?;
    }
    for [x, y, z] in &mesh.normals {
        writeln!(out, "vn {x:.4} {y:.4} {z:.4}")?;
    }
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|vertex| vertex + 1);
        writeln!(out, "f {a}//{a} {b}//{b} {c}//{c}")?;
    }
    Ok(())
}

/// Writes binary glTF with normals and vertex colours. The light is in the colours, so the material is
/// unlit where the reader knows `KHR_materials_unlit`. Axes of glTF: y up; the first camera looks along
/// -z; metres.
///
/// # Errors
/// If writing fails or the file would exceed 4 GiB.
pub fn write_mesh_glb(out: &mut impl Write, mesh: &Mesh) -> io::Result<()> {
    let mut glb = Glb::default();
    glb.positions(mesh.positions.iter().map(|position| y_up(*position)));
    glb.floats("NORMAL", mesh.normals.iter().map(|normal| y_up(*normal)));
    glb.floats("COLOR_0", mesh.colors.iter().map(|color| color.map(linear)));
    let indices = glb.indices(&mesh.triangles);
    let primitive = json!({ "mode": TRIANGLES, "indices": indices, "material": 0 });
    let rest = json!({
        "extensionsUsed": ["KHR_materials_unlit"],
        "materials": [{
            "pbrMetallicRoughness": { "metallicFactor": 0.0, "roughnessFactor": 1.0 },
            "extensions": { "KHR_materials_unlit": {} }
        }]
    });
    glb.write(out, primitive, rest)
}
