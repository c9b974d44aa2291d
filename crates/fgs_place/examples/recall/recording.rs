//! A recording reduced to what the measurement needs.

use std::path::Path;

use anyhow::{Context, Result};
use fgs_data::{Dataset, OpenOptions};
use fgs_geom::{Camera, Image, RgbdFrame, Se3, has_depth};
use fgs_place::PlaceDescriptor;
use nalgebra::Vector3;

use crate::change::Change;

/// Every so many pixels, along rows and columns, overlap is measured.
const STRIDE: usize = 16;

pub struct Recording {
    pub camera: Camera,
    pub shots: Vec<Shot>,
}

/// One frame.
pub struct Shot {
    pub world_from_camera: Se3,
    /// For each of [`Change::ALL`].
    pub descriptors: Vec<PlaceDescriptor>,
    /// Every `STRIDE`-th pixel.
    depth_m: Image<f32>,
}

impl Recording {
    pub fn read(dir: &Path) -> Result<Self> {
        let dataset = Dataset::open(dir, &OpenOptions::default())?;
        let truth = dataset.ground_truth().context("no known poses")?;
        let mut shots = Vec::new();
        for frame in dataset.frames(0..dataset.len()) {
            let frame = frame?;
            let Some(world_from_camera) = truth.at(frame.timestamp_secs) else {
                continue;
            };
            shots.push(Shot::new(&frame, world_from_camera));
        }
        Ok(Self {
            camera: *dataset.camera(),
            shots,
        })
    }

    /// Share of the surface points of `a` that `b` shows too: inside the image, within a tenth of
    /// the depth there, or where there is none.
    pub fn overlap(&self, a: &Shot, b: &Shot) -> f64 {
        let k = self.camera.intrinsics;
        let b_from_a = b.world_from_camera.inverse() * a.world_from_camera;
        let (mut points, mut seen) = (0.0_f64, 0.0);
        for v in 0..a.depth_m.height() {
            for u in 0..a.depth_m.width() {
                let z = f64::from(a.depth_m.at(u, v));
                if z == 0.0 {
                    continue;
                }
                points += 1.0;
                let [x, y] = [
                    ((u * STRIDE) as f64 - k.cx) / k.fx * z,
                    ((v * STRIDE) as f64 - k.cy) / k.fy * z,
                ];
                let p = b_from_a.transform(&Vector3::new(x, y, z));
                let [bu, bv] = [p.x / p.z * k.fx + k.cx, p.y / p.z * k.fy + k.cy]
                    .map(|pixel| pixel / STRIDE as f64);
                if p.z > 0.0 && bu >= 0.0 && bv >= 0.0 {
                    let depth_m = b.depth_m.get(bu as usize, bv as usize).map(f64::from);
                    seen +=
                        f64::from(depth_m.is_some_and(|d| d == 0.0 || (d - p.z).abs() < 0.1 * p.z));
                }
            }
        }
        seen / points.max(1.0)
    }
}

impl Shot {
    fn new(frame: &RgbdFrame, world_from_camera: Se3) -> Self {
        let (width, height) = (frame.camera.width, frame.camera.height);
        Self {
            world_from_camera,
            descriptors: (Change::ALL.iter())
                .map(|change| PlaceDescriptor::new(&change.of(frame)))
                .collect(),
            depth_m: Image::from_fn(width / STRIDE, height / STRIDE, |u, v| {
                let depth_m = frame.depth_m.at(u * STRIDE, v * STRIDE);
                if has_depth(depth_m) { depth_m } else { 0.0 }
            }),
        }
    }
}
