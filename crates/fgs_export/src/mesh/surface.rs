//! The zero surface of a volume by naive surface nets, block by block.
//!
//! Each cell of 2x2x2 voxels that the surface crosses has one vertex. Neighbouring blocks share cells,
//! whose vertices are merged. There is no surface, but the end of what is known, where a cell has a
//! voxel that no view has seen, and where distances jump: behind a surface begins what other views have
//! seen past its edge. Triangles with a vertex in such a cell are left out.

use std::collections::HashMap;

use fast_surface_nets::ndshape::{ConstShape, ConstShape3u32};
use fast_surface_nets::{SurfaceNetsBuffer, surface_nets};
use nalgebra::Vector3;
use rayon::prelude::*;

use super::Mesh;
use super::volume::{Cell, SIDE, Volume, Voxel};

/// A block with one voxel more on each side: so that neighbours' triangles meet.
const PADDED: u32 = SIDE as u32 + 2;
type Padded = ConstShape3u32<PADDED, PADDED, PADDED>;

/// Across a surface, distances in a cell differ by less, unless it is seen at a grazing angle only.
const MAX_JUMP: f32 = 1.5;

/// What a block contributes.
#[derive(Default)]
struct Patch {
    /// For each vertex its cell, position and normal.
    vertices: Vec<(Cell, [f32; 3], [f32; 3])>,
    triangles: Vec<[usize; 3]>,
}

impl Volume {
    /// The surface, without colours.
    pub(super) fn surface(&self) -> Mesh {
        let cells: Vec<Cell> = self.blocks.keys().copied().collect();
        let patches: Vec<Patch> = cells
            .into_par_iter()
            .map_init(SurfaceNetsBuffer::default, |buffer, cell| {
                self.patch(cell, buffer)
            })
            .collect();
        let mut mesh = Mesh::default();
        let mut places = HashMap::new();
        for patch in patches {
            let indices: Vec<u32> = patch
                .vertices
                .iter()
                .map(|(cell, position, normal)| {
                    *places.entry(*cell).or_insert_with(|| {
                        mesh.positions.push(*position);
                        mesh.normals.push(*normal);
                        mesh.positions.len() as u32 - 1
                    })
                })
                .collect();
            let triangles = patch.triangles.iter();
            mesh.triangles
                .extend(triangles.map(|triangle| triangle.map(|vertex| indices[vertex])));
        }
        mesh
    }

    fn patch(&self, block: Cell, buffer: &mut SurfaceNetsBuffer) -> Patch {
        let voxels = self.padded(block);
        // What was not seen counts as free.
        let distances = voxels.map(|voxel| {
            if voxel.weight > 0.0 {
                voxel.distance
            } else {
                1.0
            }
        });
        surface_nets(&distances, &Padded {}, [0; 3], [PADDED - 1; 3], buffer);

        let is_known = |vertex: u32| {
            let [x, y, z] = buffer.surface_points[vertex as usize];
            let (mut min, mut max) = (f32::INFINITY, f32::NEG_INFINITY);
            for corner in 0..8 {
                let corner = [x + (corner & 1), y + (corner >> 1 & 1), z + (corner >> 2)];
                let voxel = voxels[Padded::linearize(corner) as usize];
                if voxel.weight == 0.0 {
                    return false;
                }
                (min, max) = (min.min(voxel.distance), max.max(voxel.distance));
            }
            max - min <= MAX_JUMP
        };
        let first = block.map(|i| SIDE as i32 * i - 1);
        let mut patch = Patch::default();
        let mut places = HashMap::new();
        let triangles = buffer.indices.as_chunks::<3>().0.iter();
        for triangle in triangles.filter(|triangle| triangle.iter().all(|i| is_known(*i))) {
            patch.triangles.push(triangle.map(|vertex| {
                *places.entry(vertex).or_insert_with(|| {
                    let vertex = vertex as usize;
                    let place = buffer.surface_points[vertex];
                    let cell = [0, 1, 2].map(|axis| first[axis] + place[axis] as i32);
                    let position = [0, 1, 2].map(|axis| {
                        let position = f64::from(buffer.positions[vertex][axis]);
                        (self.voxel_m * (f64::from(first[axis]) + position)) as f32
                    });
                    let normal = Vector3::from(buffer.normals[vertex]);
                    let normal = normal.try_normalize(0.0).unwrap_or_default();
                    patch.vertices.push((cell, position, normal.into()));
                    patch.vertices.len() - 1
                })
            }));
        }
        patch
    }

    /// The voxels of a block and those around it, in the order of [`Padded`].
    fn padded(&self, block: Cell) -> [Voxel; Padded::USIZE] {
        let side = SIDE as i32;
        let mut voxels = [Voxel::default(); Padded::USIZE];
        let neighbors: [_; 27] = std::array::from_fn(|i| {
            let offset = [i % 3, i / 3 % 3, i / 9].map(|offset| offset as i32 - 1);
            self.blocks
                .get(&[0, 1, 2].map(|axis| block[axis] + offset[axis]))
        });
        for (i, voxel) in voxels.iter_mut().enumerate() {
            let place = Padded::delinearize(i as u32).map(|x| x as i32 - 1);
            let [x, y, z] = place.map(|x| (x.div_euclid(side) + 1) as usize);
            if let Some(neighbor) = neighbors[x + 3 * y + 9 * z] {
                let [x, y, z] = place.map(|x| x.rem_euclid(side) as usize);
                *voxel = neighbor[x + SIDE * (y + SIDE * z)];
            }
        }
        voxels
    }
}
