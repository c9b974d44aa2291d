//! Binary glTF 2.0 files (GLB) of one mesh: JSON and one buffer.

use std::io::{self, Write};

use serde_json::{Map, Value, json};

/// Codes of glTF.
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

const MAGIC: u32 = 0x4654_6c67;
const VERSION: u32 = 2;
const JSON_CHUNK: u32 = 0x4e4f_534a;
const BIN_CHUNK: u32 = 0x004e_4942;

/// A primitive in the making: arrays first, then [`Glb::write`].
#[derive(Default)]
pub(crate) struct Glb {
    buffer: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    attributes: Map<String, Value>,
}

impl Glb {
    /// Adds positions, with the bounds that glTF wants of them.
    pub fn positions(&mut self, rows: impl Iterator<Item = [f32; 3]> + Clone) {
        let extreme = |pick: fn(f32, f32) -> f32| {
            let extreme = rows
                .clone()
                .reduce(|a, b| [0, 1, 2].map(|i| pick(a[i], b[i])));
            extreme.unwrap_or_default()
        };
        let (min, max) = (extreme(f32::min), extreme(f32::max));
        self.floats("POSITION", rows);
        if let Some(accessor) = self.accessors.last_mut() {
            accessor["min"] = json!(min);
            accessor["max"] = json!(max);
        }
    }

    /// Adds a vertex attribute of `N` floats.
    pub fn floats<const N: usize>(&mut self, name: &str, rows: impl Iterator<Item = [f32; N]>) {
        let start = self.buffer.len();
        let mut count = 0;
        for row in rows {
            self.buffer.extend(row.iter().flat_map(|x| x.to_le_bytes()));
            count += 1;
        }
        let kind = match N {
            1 => "SCALAR",
            3 => "VEC3",
            _ => "VEC4",
        };
        let accessor = json!({ "componentType": FLOAT, "count": count, "type": kind });
        let accessor = self.accessor(start, ARRAY_BUFFER, accessor);
        self.attributes.insert(name.into(), accessor);
    }

    /// Adds the triangles' vertices; returns what a primitive calls `indices`.
    pub fn indices(&mut self, triangles: &[[u32; 3]]) -> Value {
        let start = self.buffer.len();
        let indices = triangles.as_flattened();
        self.buffer
            .extend(indices.iter().flat_map(|i| i.to_le_bytes()));
        let accessor = json!({
            "componentType": UNSIGNED_INT, "count": indices.len(), "type": "SCALAR"
        });
        self.accessor(start, ELEMENT_ARRAY_BUFFER, accessor)
    }

    /// Describes the buffer's bytes from `start` on.
    fn accessor(&mut self, start: usize, target: u32, mut accessor: Value) -> Value {
        accessor["bufferView"] = self.views.len().into();
        self.views.push(json!({
            "buffer": 0, "byteOffset": start, "byteLength": self.buffer.len() - start,
            "target": target
        }));
        self.accessors.push(accessor);
        (self.accessors.len() - 1).into()
    }

    /// Writes the file. `primitive` is the mesh primitive without its attributes; `rest` holds further
    /// members of the root object.
    ///
    /// # Errors
    /// If writing fails or the file would exceed 4 GiB.
    pub fn write(self, out: &mut impl Write, mut primitive: Value, rest: Value) -> io::Result<()> {
        primitive["attributes"] = self.attributes.into();
        let mut root = rest;
        root["asset"] = json!({ "version": "2.0", "generator": "fgs-slam" });
        root["scene"] = json!(0);
        root["scenes"] = json!([{ "nodes": [0] }]);
        root["nodes"] = json!([{ "mesh": 0 }]);
        root["meshes"] = json!([{ "primitives": [primitive] }]);
        root["accessors"] = self.accessors.into();
        root["bufferViews"] = self.views.into();
        root["buffers"] = json!([{ "byteLength": self.buffer.len() }]);
        let mut json = serde_json::to_vec(&root)?;
        // Chunks begin at multiples of four.
        json.resize(json.len().next_multiple_of(4), b' ');

        let (header, chunk_header) = (12, 8);
        let total = header + 2 * chunk_header + json.len() + self.buffer.len();
        for word in [MAGIC, VERSION, word(total)?, word(json.len())?, JSON_CHUNK] {
            out.write_all(&word.to_le_bytes())?;
        }
        out.write_all(&json)?;
        for word in [word(self.buffer.len())?, BIN_CHUNK] {
            out.write_all(&word.to_le_bytes())?;
        }
        out.write_all(&self.buffer)
    }
}

fn word(bytes: usize) -> io::Result<u32> {
    u32::try_from(bytes).map_err(|_| io::Error::other("a GLB file cannot exceed 4 GiB"))
}
