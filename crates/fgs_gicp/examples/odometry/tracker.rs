//! Frame-to-map tracking: aligns each frame to the map, starting from a constant-velocity
//! prediction. When the overlap becomes too small, adds the points missing from the map.

use std::time::Instant;

use anyhow::Result;
use fgs_geom::{Camera, Image, Se3};
use fgs_gicp::{
    Covariance, DepthGrid, Point, PointMap, SurfacePoint, align, covariances_from_neighbors,
};

use crate::recipe::Recipe;

/// Frame-to-map tracker with a sparse map.
pub struct Tracker {
    pub recipe: Recipe,
    pub map: PointMap,
    next_id: u64,
    world_from_camera: Option<Se3>,
    /// Motion between the last two frames, `previous_from_current`.
    motion: Se3,
    pub keyframes: usize,
    pub lost: usize,
    pub iterations: usize,
    pub preparation_secs: f64,
}

impl Tracker {
    pub fn new(recipe: Recipe) -> Self {
        Self {
            map: PointMap::new(recipe.cell_m),
            recipe,
            next_id: 0,
            world_from_camera: None,
            motion: Se3::identity(),
            keyframes: 0,
            lost: 0,
            iterations: 0,
            preparation_secs: 0.0,
        }
    }

    pub fn track(&mut self, depth_m: &Image<f32>, camera: &Camera) -> Result<Se3> {
        let start = Instant::now();
        let source = self.points(depth_m, camera, self.recipe.grid.stride_px);
        self.preparation_secs = start.elapsed().as_secs_f64();
        let Some(previous) = self.world_from_camera else {
            self.add_keyframe(depth_m, camera, &source, Se3::identity());
            return Ok(Se3::identity());
        };
        let start = if self.recipe.constant_velocity {
            previous * self.motion
        } else {
            previous
        };
        let (pose, overlap) = match align(&source, &self.map, &start, &self.recipe.settings) {
            Ok(alignment) => {
                self.iterations = alignment.iterations;
                if !alignment.converged {
                    self.lost += 1;
                }
                (alignment.target_from_source, alignment.inlier_share)
            }
            Err(error) => {
                eprintln!("{error}");
                self.lost += 1;
                (start, 1.0)
            }
        };
        self.motion = previous.inverse() * pose;
        self.world_from_camera = Some(pose);
        if overlap < self.recipe.min_overlap {
            self.add_keyframe(depth_m, camera, &source, pose);
        }
        Ok(pose)
    }

    fn add_keyframe(&mut self, depth_m: &Image<f32>, camera: &Camera, source: &[Point], pose: Se3) {
        self.keyframes += 1;
        if self.recipe.replace {
            self.map = PointMap::new(self.recipe.cell_m);
        }
        let denser;
        let points = if self.recipe.map_stride == self.recipe.grid.stride_px {
            source
        } else {
            denser = self.points(depth_m, camera, self.recipe.map_stride);
            &denser
        };
        for point in points {
            let point = point.transformed(&pose);
            if self
                .map
                .nearest(&point.position, self.recipe.spacing_m)
                .is_none()
            {
                self.map.insert(self.next_id, point);
                self.next_id += 1;
            }
        }
        self.world_from_camera = Some(pose);
    }

    fn points(&self, depth_m: &Image<f32>, camera: &Camera, stride_px: usize) -> Vec<Point> {
        let recipe = &self.recipe;
        let grid = DepthGrid {
            stride_px,
            ..recipe.grid
        };
        let surface = grid.surface_points(depth_m, camera);
        let position = |point: &SurfacePoint| {
            let position = if recipe.fitted {
                point.fitted
            } else {
                point.measured
            };
            position.cast::<f32>()
        };
        let covariances: Vec<Option<Covariance>> = match recipe.covariance.as_str() {
            "neighbors" => {
                let mut map = PointMap::new(0.05);
                for (id, point) in surface.iter().enumerate() {
                    map.insert(id as u64, point.disk(recipe.thickness, 0.0));
                }
                let positions: Vec<_> = surface.iter().map(position).collect();
                covariances_from_neighbors(&map, &positions, recipe.neighbors, 0.2)
            }
            "iso" => surface
                .iter()
                .map(|_| Some(Covariance::isotropic()))
                .collect(),
            _ => surface
                .iter()
                .map(|point| Some(Covariance::disk(&point.normal, recipe.thickness)))
                .collect(),
        };
        surface
            .iter()
            .zip(covariances)
            .filter_map(|(point, covariance)| {
                let scale = point.measured.z.powf(2.0 * recipe.noise_power);
                Some(Point {
                    position: position(point),
                    covariance: covariance?.scaled(scale),
                })
            })
            .collect()
    }
}
