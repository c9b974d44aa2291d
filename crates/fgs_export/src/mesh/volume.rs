//! A block-sparse volume of truncated signed distances.
//!
//! Voxels exist in blocks of 8x8x8 near surfaces only. A voxel holds the weighted mean of its distances
//! to the surfaces seen, along the viewing axis, in units of the truncation distance, positive in
//! front. Each block is updated on its own, view by view: results do not depend on the number of
//! threads.

use std::collections::{BTreeMap, HashSet};

use fgs_geom::{Image, Intrinsics, View};
use nalgebra::Vector3;
use rayon::prelude::*;

use super::depth::depth_at;
use crate::ExportError;

/// Voxels along a block's side.
pub(super) const SIDE: usize = 8;

/// Distances are truncated to this many voxels: enough for the noise of depth, thin enough to keep the
/// two faces of a door apart.
const TRUNCATION_VOXELS: f64 = 4.0;

/// 2 GB.
const MAX_BLOCKS: usize = 500_000;

/// Nearer points are not rendered, metres.
const NEAR_M: f32 = 0.1;

/// A place in the grid of blocks or of voxels.
pub(super) type Cell = [i32; 3];

/// A voxel that no view has seen has no weight.
#[derive(Clone, Copy, Default)]
pub(super) struct Voxel {
    /// In units of the truncation distance, -1 to 1.
    pub distance: f32,
    pub weight: f32,
}

pub(super) type Block = [Voxel; SIDE * SIDE * SIDE];

/// The volume. Voxel `[i, j, k]` stands at `voxel_m * [i, j, k]`.
pub(super) struct Volume {
    pub(super) voxel_m: f64,
    pub(super) blocks: BTreeMap<Cell, Box<Block>>,
    max_blocks: usize,
}

impl Volume {
    pub(super) fn new(voxel_m: f64) -> Self {
        Self {
            voxel_m,
            blocks: BTreeMap::new(),
            max_blocks: MAX_BLOCKS,
        }
    }

    pub(super) fn truncation_m(&self) -> f32 {
        (TRUNCATION_VOXELS * self.voxel_m) as f32
    }

    /// Makes the blocks near the surfaces that a view shows. All views come here before the first is
    /// integrated: a block that missed some would not fit its neighbours. `depth_m` is of the camera's
    /// size; 0 where there is no surface.
    ///
    /// # Errors
    /// [`ExportError::TooManyVoxels`].
    pub(super) fn allocate(
        &mut self,
        depth_m: &Image<f32>,
        view: &View,
    ) -> Result<(), ExportError> {
        for cell in self.blocks_near_surface(depth_m, view) {
            if self.blocks.len() >= self.max_blocks && !self.blocks.contains_key(&cell) {
                let voxel_m = self.voxel_m;
                return Err(ExportError::TooManyVoxels { voxel_m });
            }
            self.blocks
                .entry(cell)
                .or_insert_with(|| Box::new([Voxel::default(); SIDE * SIDE * SIDE]));
        }
        Ok(())
    }

    /// Adds what a view shows to the blocks that there are.
    pub(super) fn integrate(&mut self, depth_m: &Image<f32>, view: &View) {
        let update = Update::new(depth_m, view, self.voxel_m, self.truncation_m());
        self.blocks
            .par_iter_mut()
            .for_each(|(cell, block)| update.apply(*cell, block));
    }

    /// The blocks within the truncation distance of a pixel's surface point, along its ray.
    fn blocks_near_surface(&self, depth_m: &Image<f32>, view: &View) -> HashSet<Cell> {
        let block_m = self.voxel_m * SIDE as f64;
        // A block is twice as long as the truncation distance: no step leaves one out.
        let offsets_m = [-1.0, 0.0, 1.0].map(|step| step * f64::from(self.truncation_m()));
        let rows = (0..depth_m.height()).into_par_iter().map(|v| {
            let mut cells = HashSet::new();
            for (u, depth_m) in depth_m.row(v).iter().enumerate() {
                if *depth_m == 0.0 {
                    continue;
                }
                for offset_m in offsets_m {
                    let depth_m = f64::from(*depth_m) + offset_m;
                    let point = view.camera.unproject(u as f64, v as f64, depth_m);
                    let point = view.world_from_camera.transform(&point) / block_m;
                    cells.insert(point.map(|x| x.floor() as i32).into());
                }
            }
            cells
        });
        rows.reduce(HashSet::new, |mut all, cells| {
            all.extend(cells);
            all
        })
    }
}

/// What one view changes.
struct Update<'a> {
    depth_m: &'a Image<f32>,
    view: &'a View,
    voxel_m: f64,
    truncation_m: f32,
    /// From a voxel to the next along each axis, in the camera's axes, metres.
    steps: [Vector3<f32>; 3],
}

impl<'a> Update<'a> {
    fn new(depth_m: &'a Image<f32>, view: &'a View, voxel_m: f64, truncation_m: f32) -> Self {
        let camera_from_world = view.world_from_camera.rotation.inverse();
        let step = |axis: Vector3<f64>| (camera_from_world * axis * voxel_m).cast();
        Self {
            depth_m,
            view,
            voxel_m,
            truncation_m,
            steps: [Vector3::x(), Vector3::y(), Vector3::z()].map(step),
        }
    }

    fn apply(&self, cell: Cell, block: &mut Block) {
        let origin = Vector3::from(cell).cast::<f64>() * (SIDE as f64 * self.voxel_m);
        let origin = self.view.world_from_camera.inverse().transform(&origin);
        let origin: Vector3<f32> = origin.cast();
        if !self.may_see(&origin) {
            return;
        }
        let [step_x, step_y, step_z] = &self.steps;
        let mut voxels = block.iter_mut();
        for z in 0..SIDE {
            for y in 0..SIDE {
                let row = origin + step_y * y as f32 + step_z * z as f32;
                for (x, voxel) in voxels.by_ref().take(SIDE).enumerate() {
                    self.apply_to_voxel(&(row + step_x * x as f32), voxel);
                }
            }
        }
    }

    /// Whether the sphere around a block, of which a corner is given, reaches into the view.
    fn may_see(&self, origin: &Vector3<f32>) -> bool {
        let [step_x, step_y, step_z] = &self.steps;
        let to_center = (step_x + step_y + step_z) * (0.5 * (SIDE - 1) as f32);
        let (center, radius) = (origin + to_center, to_center.norm());
        let camera = &self.view.camera;
        let first = camera.ray(0.0, 0.0);
        let last = camera.ray(camera.width as f64, camera.height as f64);
        let inside = |x: f32, slope: f64| {
            let slope = slope as f32;
            x - slope * center.z >= -radius * (1.0 + slope * slope).sqrt()
        };
        center.z + radius > NEAR_M
            && inside(center.x, first.x)
            && inside(-center.x, -last.x)
            && inside(center.y, first.y)
            && inside(-center.y, -last.y)
    }

    fn apply_to_voxel(&self, point: &Vector3<f32>, voxel: &mut Voxel) {
        if point.z < NEAR_M {
            return;
        }
        let Intrinsics { fx, fy, cx, cy } = self.view.camera.intrinsics;
        let u = fx as f32 * point.x / point.z + cx as f32;
        let v = fy as f32 * point.y / point.z + cy as f32;
        let Some(depth_m) = depth_at(self.depth_m, u, v) else {
            return;
        };
        let distance = (depth_m - point.z) / self.truncation_m;
        if distance < -1.0 {
            // Behind the surface: not seen.
            return;
        }
        // A pixel covers an area that grows with the square of depth.
        let weight = 1.0 / (depth_m * depth_m);
        let sum = voxel.weight + weight;
        voxel.distance += (distance.min(1.0) - voxel.distance) * weight / sum;
        voxel.weight = sum;
    }
}

#[cfg(test)]
mod tests {
    use fgs_geom::{Camera, Se3};
    use nalgebra::Vector2;

    use super::*;

    fn view() -> View {
        let intrinsics = Intrinsics {
            fx: 60.0,
            fy: 60.0,
            cx: 39.5,
            cy: 29.5,
        };
        View {
            camera: Camera::new(80, 60, intrinsics).unwrap(),
            world_from_camera: Se3::from_wxyz([0.9, 0.1, -0.3, 0.2], [1.0, 2.0, -3.0]).unwrap(),
        }
    }

    /// A slanted plane, with a hole in the middle.
    fn plane(view: &View, hole: bool) -> Image<f32> {
        Image::from_fn(view.camera.width, view.camera.height, |u, v| {
            let is_hole = hole && (30..50).contains(&u) && (20..40).contains(&v);
            let ray = view.camera.ray(u as f64, v as f64);
            let depth_m = 1.5 / (1.0 + 0.3 * ray.x - 0.2 * ray.y);
            if is_hole { 0.0 } else { depth_m as f32 }
        })
    }

    #[test]
    fn a_plane_comes_back_and_ends_where_nothing_was_seen() {
        let view = view();
        let mut volume = Volume::new(0.02);
        let plane = plane(&view, true);
        volume.allocate(&plane, &view).unwrap();
        volume.integrate(&plane, &view);
        let mesh = volume.surface();
        let mut pixels = Vec::new();
        for position in &mesh.positions {
            let position = Vector3::from(*position).cast();
            let point = view.world_from_camera.inverse().transform(&position);
            let normal = Vector3::new(0.3, -0.2, 1.0);
            let distance_m = (normal.dot(&point) - 1.5) / normal.norm();
            assert!(distance_m.abs() <= 1e-3, "{distance_m}");
            let pixel = view.camera.project(&point).unwrap();
            let in_hole = (pixel.x - 39.5).abs() < 9.0 && (pixel.y - 29.5).abs() < 9.0;
            assert!(!in_hole, "{pixel}");
            pixels.push(pixel);
        }
        // All the rest is there, up to the image's border.
        for v in (0..60).step_by(3) {
            for u in (0..80)
                .step_by(3)
                .filter(|u| !(27..54).contains(u) || !(17..44).contains(&v))
            {
                let pixel = Vector2::new(f64::from(u), f64::from(v));
                let is_near = pixels.iter().any(|other| (other - pixel).norm() < 3.0);
                assert!(is_near, "{pixel}");
            }
        }
    }

    #[test]
    fn a_stray_view_counts_no_more_than_another() {
        let view = view();
        let mut volume = Volume::new(0.02);
        let plane = plane(&view, false);
        volume.allocate(&plane, &view).unwrap();
        for _ in 0..9 {
            volume.integrate(&plane, &view);
        }
        volume.integrate(&plane.map(|depth_m| 2.0 * depth_m), &view);
        let surface = volume.surface();
        assert!(!surface.triangles.is_empty());
        for position in surface.positions {
            let position = Vector3::from(position).cast();
            let point = view.world_from_camera.inverse().transform(&position);
            let distance_m = (Vector3::new(0.3, -0.2, 1.0).dot(&point) - 1.5).abs();
            assert!(distance_m <= 0.005, "{distance_m}");
        }
    }

    #[test]
    fn what_a_later_view_sees_through_goes() {
        let view = view();
        let mut volume = Volume::new(0.02);
        let wall = plane(&view, false);
        let ghost = wall.map(|depth_m| 0.5 * depth_m);
        for depth_m in [&ghost, &wall] {
            volume.allocate(depth_m, &view).unwrap();
        }
        volume.integrate(&ghost, &view);
        for _ in 0..20 {
            volume.integrate(&wall, &view);
        }
        assert!(!volume.surface().triangles.is_empty());
        for position in volume.surface().positions {
            let position = Vector3::from(position).cast();
            let point = view.world_from_camera.inverse().transform(&position);
            assert!(point.z > 0.9, "{point}");
        }
    }

    #[test]
    fn memory_is_limited() {
        let view = view();
        let mut volume = Volume::new(0.02);
        volume.max_blocks = 50;
        let refused = volume.allocate(&plane(&view, false), &view).unwrap_err();
        assert!(matches!(refused, ExportError::TooManyVoxels { .. }));
        assert!(volume.blocks.len() <= 50);
    }
}
