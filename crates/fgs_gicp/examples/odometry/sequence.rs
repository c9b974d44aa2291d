//! A depth sequence in the Replica or TUM layout.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use fgs_geom::{Camera, Image, Intrinsics, Se3};
use nalgebra::Matrix4;

/// A depth sequence with reference poses.
pub struct Sequence {
    pub camera: Camera,
    depth_scale: f32,
    pub depth_files: Vec<PathBuf>,
    pub world_from_camera: Vec<Se3>,
}

impl Sequence {
    pub fn open(dir: &Path) -> Result<Self> {
        let camera_text = std::fs::read_to_string(dir.join("camera.toml")).unwrap_or(
            "width = 1200\nheight = 680\nfx = 600.0\nfy = 600.0\ncx = 599.5\ncy = 339.5\ndepth_scale = 6553.5"
                .into(),
        );
        let value = |key: &str| -> Result<f64> {
            camera_text
                .lines()
                .filter_map(|line| line.split_once('='))
                .find(|(name, _)| name.trim() == key)
                .and_then(|(_, value)| value.trim().parse().ok())
                .with_context(|| format!("camera.toml: {key}"))
        };
        let intrinsics = Intrinsics {
            fx: value("fx")?,
            fy: value("fy")?,
            cx: value("cx")?,
            cy: value("cy")?,
        };
        let camera = Camera::new(
            value("width")? as usize,
            value("height")? as usize,
            intrinsics,
        )?;
        let tum = dir.join("depth.txt").exists();
        let lines = |file: &str| -> Result<Vec<Vec<String>>> {
            let text = std::fs::read_to_string(dir.join(file)).with_context(|| file.to_owned())?;
            Ok(text
                .lines()
                .filter(|line| !line.starts_with('#'))
                .map(|line| line.split_whitespace().map(str::to_owned).collect())
                .collect())
        };
        let numbers = |row: &[String]| -> Result<Vec<f64>> {
            row.iter().map(|text| Ok(text.parse()?)).collect()
        };
        let mut world_from_camera = Vec::new();
        let depth_files = if tum {
            for row in lines("groundtruth.txt")? {
                let x = numbers(&row)?;
                let pose = Se3::from_wxyz([x[7], x[4], x[5], x[6]], [x[1], x[2], x[3]]);
                world_from_camera.push(pose.context("bad pose")?);
            }
            lines("depth.txt")?
                .iter()
                .map(|row| dir.join(&row[1]))
                .collect()
        } else {
            for row in lines("traj.txt")? {
                let pose = Se3::from_matrix(&Matrix4::from_row_slice(&numbers(&row)?));
                world_from_camera.push(pose.context("bad pose")?);
            }
            (0..world_from_camera.len())
                .map(|i| dir.join(format!("results/depth{i:06}.png")))
                .collect()
        };
        Ok(Self {
            camera,
            depth_scale: value("depth_scale")? as f32,
            depth_files,
            world_from_camera,
        })
    }

    pub fn read_depth(&self, file: &Path) -> Result<Image<f32>> {
        let image = image::open(file)?.into_luma16();
        let (width, height) = (image.width() as usize, image.height() as usize);
        let depth = image
            .into_raw()
            .iter()
            .map(|&d| f32::from(d) / self.depth_scale)
            .collect();
        Ok(Image::new(width, height, depth)?)
    }
}
