//! Odometry by registration alone: tracks a depth sequence against a sparse map that grows at
//! keyframes, and reports the absolute trajectory error.
//!
//! `cargo run --release -p fgs_gicp --example odometry -- DIR [key=value ...]`, where DIR holds
//! `results/depthNNNNNN.png` and `traj.txt` (Replica layout) or `depth.txt` and `groundtruth.txt`
//! (TUM layout), and `camera.toml`. The keys are the fields of [`Recipe`].

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Instant;

use anyhow::{Context, Result, anyhow, bail};
use fgs_geom::{Camera, Image, Intrinsics, Se3};
use fgs_gicp::{
    Covariance, DepthGrid, Kernel, Point, PointMap, Settings, SurfacePoint, align,
    covariances_from_neighbors,
};
use nalgebra::{Matrix3, Matrix4, Vector3};

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (dir, options) = arguments
        .split_first()
        .context("usage: odometry DIR [key=value ...]")?;
    let sequence = Sequence::open(Path::new(dir))?;
    let recipe = Recipe::parse(options)?;
    let mut tracker = Tracker::new(recipe);
    let mut estimated = Vec::new();
    let (mut secs, mut iterations) = (0.0, 0);
    let frames = sequence.depth_files.len().min(tracker.recipe.frames);
    let mut preparation = 0.0;
    for file in &sequence.depth_files[..frames] {
        let depth_m = sequence.read_depth(file)?;
        let start = Instant::now();
        let pose = tracker.track(&depth_m, &sequence.camera)?;
        secs += start.elapsed().as_secs_f64();
        preparation += tracker.preparation_secs;
        iterations += tracker.iterations;
        estimated.push(pose);
    }
    if let Ok(path) = std::env::var("TRAJECTORY") {
        let lines: Vec<String> = estimated
            .iter()
            .enumerate()
            .map(|(i, pose)| {
                let (t, q) = (pose.translation, pose.rotation.coords);
                format!(
                    "{i} {} {} {} {} {} {} {}\n",
                    t.x, t.y, t.z, q.x, q.y, q.z, q.w
                )
            })
            .collect();
        std::fs::write(path, lines.concat())?;
    }
    let reference = &sequence.world_from_camera[..frames];
    let n = frames as f64;
    println!(
        "ATE {:.4} cm  RPE {:.3} mm  {:.1} ms/frame ({:.1} prep)  {:.1} iterations  {} keyframes  {} points  {} lost",
        100.0 * absolute_error(&estimated, reference),
        1000.0 * relative_error(&estimated, reference),
        1000.0 * secs / n,
        1000.0 * preparation / n,
        iterations as f64 / n,
        tracker.keyframes,
        tracker.map.len(),
        tracker.lost,
    );
    Ok(())
}

/// The variant to try.
#[derive(Debug)]
struct Recipe {
    frames: usize,
    grid: DepthGrid,
    settings: Settings,
    /// Use the fitted rather than the measured position.
    fitted: bool,
    /// `disk`, `iso` or `neighbors`.
    covariance: String,
    /// Variance along a disk's normal, relative to that across.
    thickness: f64,
    /// Neighbours of a `neighbors` covariance.
    neighbors: usize,
    /// Covariances grow with this power of depth.
    noise_power: f64,
    /// Start from the previous motion rather than the previous pose.
    constant_velocity: bool,
    /// New map points keep this distance from old ones.
    spacing_m: f32,
    /// Keyframe when fewer than this share of points have a map point ...
    min_overlap: f64,
    /// ... within this distance.
    overlap_distance_m: f32,
    /// Replace the map at each keyframe rather than add to it.
    replace: bool,
    /// Side of the map's cells.
    cell_m: f32,
    /// Tracking grid and map grid.
    map_stride: usize,
}

impl Recipe {
    fn parse(options: &[String]) -> Result<Self> {
        let mut values = HashMap::new();
        for option in options {
            let (key, value) = option
                .split_once('=')
                .with_context(|| format!("{option}: no ="))?;
            values.insert(key, value);
        }
        let mut get = |key: &str, default: f64| match values.remove(key) {
            Some(value) => f64::from_str(value).map_err(|e| anyhow!("{key}: {e}")),
            None => Ok(default),
        };
        let stride = get("stride", 5.0)? as usize;
        let grid = DepthGrid {
            stride_px: stride,
            window_radius_px: get("window", 4.0)? as usize,
            window_step_px: get("step", 2.0)? as usize,
            max_depth_m: get("max_depth", 100.0)? as f32,
            max_depth_step: get("max_step", 0.05)? as f32,
            max_fit_error: get("max_fit", 0.01)?,
            min_cosine: get("min_cos", 0.1)?,
            min_support: get("support", 0.5)?,
        };
        let scale_m = get("scale", 0.005)?;
        let recipe = Self {
            frames: get("frames", 1e9)? as usize,
            grid,
            fitted: get("fitted", 1.0)? > 0.0,
            thickness: get("thickness", 1e-3)?,
            neighbors: get("neighbors", 20.0)? as usize,
            noise_power: get("noise", 0.0)?,
            constant_velocity: get("velocity", 1.0)? > 0.0,
            spacing_m: get("spacing", 0.005)? as f32,
            min_overlap: get("overlap", 0.8)?,
            overlap_distance_m: get("overlap_distance", 1e-3f64.sqrt())? as f32,
            replace: get("replace", 0.0)? > 0.0,
            cell_m: get("cell", 0.03)? as f32,
            map_stride: get("map_stride", stride as f64)? as usize,
            settings: Settings {
                max_correspondence_distance_m: get("distance", 0.03)? as f32,
                kernel: Kernel::None,
                max_iterations: get("iterations", 64.0)? as usize,
                rotation_epsilon_rad: get("rot", 2e-3)?,
                translation_epsilon_m: get("trans", 5e-4)?,
            },
            covariance: values.remove("cov").unwrap_or("disk").to_owned(),
        };
        let kernel = match values.remove("kernel").unwrap_or("none") {
            "none" => Kernel::None,
            "cauchy" => Kernel::Cauchy { scale_m },
            "gm" => Kernel::GemanMcClure { scale_m },
            "huber" => Kernel::Huber { scale_m },
            other => bail!("kernel={other}"),
        };
        if let Some(key) = values.keys().next() {
            bail!("unknown key {key}");
        }
        let settings = Settings {
            kernel,
            ..recipe.settings
        };
        Ok(Self { settings, ..recipe })
    }
}

/// Frame to sparse map.
struct Tracker {
    recipe: Recipe,
    map: PointMap,
    next_id: u64,
    world_from_camera: Option<Se3>,
    /// Motion of the last frame, `previous_from_current`.
    motion: Se3,
    keyframes: usize,
    lost: usize,
    iterations: usize,
    preparation_secs: f64,
}

impl Tracker {
    fn new(recipe: Recipe) -> Self {
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

    fn track(&mut self, depth_m: &Image<f32>, camera: &Camera) -> Result<Se3> {
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
        let pose = match align(&source, &self.map, &start, &self.recipe.settings) {
            Ok(alignment) => {
                self.iterations = alignment.iterations;
                if !alignment.converged {
                    self.lost += 1;
                }
                alignment.target_from_source
            }
            Err(error) => {
                eprintln!("{error}");
                self.lost += 1;
                start
            }
        };
        self.motion = previous.inverse() * pose;
        self.world_from_camera = Some(pose);
        let covered = source
            .iter()
            .filter(|point| {
                let position = pose.transform(&point.position.cast()).cast();
                self.map
                    .nearest(&position, self.recipe.overlap_distance_m)
                    .is_some()
            })
            .count();
        if (covered as f64) < self.recipe.min_overlap * source.len() as f64 {
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
                    map.insert(id as u64, point.disk());
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

/// A depth sequence with reference poses.
struct Sequence {
    camera: Camera,
    depth_scale: f32,
    depth_files: Vec<PathBuf>,
    world_from_camera: Vec<Se3>,
}

impl Sequence {
    fn open(dir: &Path) -> Result<Self> {
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

    fn read_depth(&self, file: &Path) -> Result<Image<f32>> {
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

/// Root mean square position error after the best rigid alignment, metres.
fn absolute_error(estimated: &[Se3], reference: &[Se3]) -> f64 {
    let n = estimated.len() as f64;
    let mean = |poses: &[Se3]| poses.iter().map(|p| p.translation).sum::<Vector3<f64>>() / n;
    let (from, to) = (mean(estimated), mean(reference));
    let pairs = || {
        let relative = |(e, r): (&Se3, &Se3)| (e.translation - from, r.translation - to);
        estimated.iter().zip(reference).map(relative)
    };
    let covariance: Matrix3<f64> = pairs().map(|(e, r)| r * e.transpose()).sum();
    let svd = covariance.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return f64::NAN;
    };
    let mirror = (u * v_t).determinant().signum();
    let rotation = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, mirror)) * v_t;
    (pairs()
        .map(|(e, r)| (rotation * e - r).norm_squared())
        .sum::<f64>()
        / n)
        .sqrt()
}

/// Root mean square error of the motion from frame to frame, metres.
fn relative_error(estimated: &[Se3], reference: &[Se3]) -> f64 {
    let motion = |poses: &[Se3]| -> Vec<Se3> {
        poses
            .windows(2)
            .map(|pair| pair[0].inverse() * pair[1])
            .collect()
    };
    let (e, r) = (motion(estimated), motion(reference));
    let errors = e
        .iter()
        .zip(&r)
        .map(|(e, r)| (r.inverse() * *e).translation.norm_squared());
    (errors.sum::<f64>() / e.len() as f64).sqrt()
}
