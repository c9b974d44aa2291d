//! How depth sensor and colour camera move, each measured by its own images.
//!
//! Input: frames in order. The colour images of neighbouring frames are aligned, which gives
//! velocities. Between frames some way apart, over which the velocity changes, the motion is measured
//! twice: by registering their depth and by aligning their colour images.

use std::collections::VecDeque;
use std::sync::Arc;

use fgs_direct::{
    ColorPair, DepthPair, IntensityImage, IntensityPyramid, Patch, PatchGrid, SensorMotion,
    align_images,
};
use fgs_geom::{Camera, DepthSensor, Image, RgbdFrame, Se3, has_depth};
use fgs_gicp::{DepthGrid, Kernel, MIN_EIGENVALUE, Point, PointMap, Settings, SurfacePoint, align};
use nalgebra::{Matrix4, Matrix4x6, Vector3, Vector4, Vector6};

use crate::median;

/// Frames between the two of a pair: a hand changes its velocity within some tenths of a second, and
/// the views still overlap.
const SPANS: [usize; 2] = [6, 16];

/// A velocity is taken from this many frames on either side. With fewer, or by a straight line, the
/// tremor of a hand would be lost; with one frame it would be noise.
const VELOCITY_FRAMES: usize = 2;

/// Frames whose motion to earlier ones is measured: enough for a tenth of the usual delays.
const MEASURED_FRAMES: usize = 150;

/// Points per frame that depth is registered by. More than for the intrinsics: motions have to be
/// known to a fraction of what the camera moves within a few milliseconds.
const GRID_POINTS: f64 = 6000.0;

/// The error of structured light and stereo grows with the square of the depth.
const NOISE_POWER: f64 = 2.0;

/// Smallest inlier ratio: below it, the frames see different things.
const MIN_INLIER_SHARE: f64 = 0.5;

/// Images are aligned at up to this width: finer details are blurred while the camera moves.
const MAX_WIDTH: usize = 400;

/// Resolutions of an image; the coarsest is 40 pixels wide, where a motion of a tenth of the image
/// is few pixels.
const LEVELS: usize = 5;

/// Points for the alignment of images: the most textured of each cell of the image, so many a row.
const CELLS: usize = 64;

/// Smallest gradient of such a point, brightness (0 to 1) per pixel; noise is half of it.
const MIN_GRADIENT: f32 = 0.01;

/// With fewer points the images do not overlap.
const MIN_POINTS: usize = 300;

/// Points whose depth in the other frame differs by a larger share are hidden there.
const MAX_DEPTH_DIFFERENCE: f64 = 0.03;

/// Collects the motions of the frames it is given.
pub struct SensorWatch {
    camera: Camera,
    /// Pairs end at every so many frames.
    every: usize,
    frames: usize,
    /// The last frames, without interruption.
    recent: VecDeque<Seen>,
    /// The pairs of colour images so far, in the order of time, ...
    pub color_pairs: Vec<ColorPair>,
    /// ... and those of the depth images of the same frames.
    pub depth_pairs: Vec<DepthPair>,
    /// How fast the image moves at its centre in each frame, pixels per second.
    pub speeds_px: Vec<f64>,
}

/// What is kept of a frame.
struct Seen {
    timestamp_secs: f64,
    depth_m: Image<f32>,
    sensor: DepthSensor,
    brightness: IntensityPyramid,
    /// Textured places, in the depth sensor's axes.
    textured: Vec<Vector3<f64>>,
    surface: Vec<Point>,
    patches: Arc<PatchGrid>,
    /// The colour camera's pose by the alignment of neighbours.
    start_from_camera: Se3,
    velocity: Vector6<f64>,
}

impl SensorWatch {
    /// For `frames` frames of this camera.
    pub fn new(camera: Camera, frames: usize) -> Self {
        Self {
            camera,
            every: frames.div_ceil(MEASURED_FRAMES).max(1),
            frames: 0,
            recent: VecDeque::new(),
            color_pairs: Vec::new(),
            depth_pairs: Vec::new(),
            speeds_px: Vec::new(),
        }
    }

    /// The motions between the pairs by both sensors.
    pub fn motions(&self) -> Vec<SensorMotion> {
        let pairs = self.color_pairs.iter().zip(&self.depth_pairs);
        let motion = |(color, depth): (&ColorPair, &DepthPair)| SensorMotion {
            depth_second_from_first: depth.second_from_first(),
            color_second_from_first: color.second_from_first(),
            velocities: color.velocities(),
        };
        pairs.map(motion).collect()
    }

    /// Says that the next frame does not directly follow the last one.
    pub fn interrupt(&mut self) {
        self.recent.clear();
    }

    /// Adds the next frame.
    pub fn add(&mut self, frame: &RgbdFrame) {
        let mut new = Seen::new(frame);
        if let Some(last) = self.recent.back() {
            let before = self.recent.iter().rev().nth(1).unwrap_or(last);
            let start = last.start_from_camera.inverse() * before.start_from_camera;
            let points = last.colored(|_| true);
            match align_images(&last.brightness, &new.brightness, &points, &start) {
                Some(aligned) => {
                    new.start_from_camera =
                        last.start_from_camera * aligned.second_from_first.inverse();
                }
                None => self.interrupt(),
            }
        }
        self.recent.push_back(new);
        self.frames += 1;
        self.measure();
        if self.recent.len() > SPANS[1] + 2 * VELOCITY_FRAMES {
            self.recent.pop_front();
        }
    }

    /// Measures the last frame whose velocity is known, and its motion from earlier ones.
    fn measure(&mut self) {
        let Some(last) = self.recent.len().checked_sub(1 + VELOCITY_FRAMES) else {
            return;
        };
        let Some(velocity) = self.velocity(last) else {
            return;
        };
        self.recent[last].velocity = velocity;
        let second = &self.recent[last];
        self.speeds_px.extend(second.speed_px(&self.camera));
        if !self.frames.is_multiple_of(self.every) {
            return;
        }
        let Some(image) = second.brightness.levels.first() else {
            return;
        };
        let image = Arc::new(image.clone());
        for span in SPANS {
            let first = last
                .checked_sub(span)
                .filter(|first| *first >= VELOCITY_FRAMES)
                .map(|first| &self.recent[first]);
            if let Some((color, depth)) =
                first.and_then(|first| pair(first, second, &image, &self.camera))
            {
                self.color_pairs.push(color);
                self.depth_pairs.push(depth);
            }
        }
    }

    /// The slope of a cubic through the motions to the neighbours, in the camera's axes.
    fn velocity(&self, center: usize) -> Option<Vector6<f64>> {
        let first = center.checked_sub(VELOCITY_FRAMES)?;
        let last = center + VELOCITY_FRAMES;
        let Seen {
            timestamp_secs,
            start_from_camera,
            ..
        } = &self.recent[center];
        // In units of the time between the neighbours.
        let unit_secs = self.recent.get(last)?.timestamp_secs - self.recent[first].timestamp_secs;
        let center_from_start = start_from_camera.inverse();
        let (mut squares, mut products) = (Matrix4::zeros(), Matrix4x6::zeros());
        for seen in self.recent.range(first..=last) {
            let time = (seen.timestamp_secs - timestamp_secs) / unit_secs;
            let powers = Vector4::new(1.0, time, time.powi(2), time.powi(3));
            let motion = (center_from_start * seen.start_from_camera).log();
            squares += powers * powers.transpose();
            products += powers * motion.transpose();
        }
        let coefficients = squares.cholesky()?.solve(&products);
        Some(coefficients.row(1).transpose() / unit_secs)
    }
}

impl Seen {
    fn new(frame: &RgbdFrame) -> Self {
        let (camera, depth_m) = (&frame.camera, &frame.depth_m);
        let mut brightness = IntensityPyramid::of_frame(frame, LEVELS);
        let too_fine = |level: &fgs_direct::IntensityImage| level.camera.width > MAX_WIDTH;
        while brightness.levels.len() > 1 && too_fine(&brightness.levels[0]) {
            brightness.levels.remove(0);
        }
        let pixels = (camera.width * camera.height) as f64;
        let grid = DepthGrid {
            stride_px: (pixels / GRID_POINTS).sqrt().ceil() as usize,
            ..DepthGrid::default()
        };
        let surface = grid.surface_points(depth_m, camera);
        let disk = |point: &SurfacePoint| point.disk(MIN_EIGENVALUE, NOISE_POWER);
        Self {
            timestamp_secs: frame.timestamp_secs,
            depth_m: depth_m.clone(),
            sensor: frame.depth_sensor,
            textured: textured(&brightness, depth_m, camera),
            brightness,
            surface: surface.iter().map(disk).collect(),
            patches: Arc::new(patch_grid(&surface, grid.stride_px, *camera)),
            start_from_camera: Se3::identity(),
            velocity: Vector6::zeros(),
        }
    }

    /// The textured places that pass, in the colour camera's axes.
    fn colored(&self, pass: impl Fn(&Vector3<f64>) -> bool) -> Vec<Vector3<f64>> {
        let color_from_depth = self.sensor.color_from_depth;
        let passing = self.textured.iter().filter(|point| pass(point));
        passing
            .map(|point| color_from_depth.transform(point))
            .collect()
    }

    /// How fast the image of something at the median depth moves at the image's centre.
    fn speed_px(&self, camera: &Camera) -> Option<f64> {
        let depth = median(self.textured.iter().map(|point| point.z).collect())?;
        let point = camera.unproject(camera.intrinsics.cx, camera.intrinsics.cy, depth);
        let [turn, shift] = [0, 3].map(|i| self.velocity.fixed_rows::<3>(i).into_owned());
        let moved = turn.cross(&point) + shift;
        Some(camera.intrinsics.fx * moved.x.hypot(moved.y) / depth)
    }
}

/// The colour and the depth images of two frames, aligned without regard to the readout; `None` if the
/// views overlap too little. `image` is the second's.
fn pair(
    first: &Seen,
    second: &Seen,
    image: &Arc<IntensityImage>,
    camera: &Camera,
) -> Option<(ColorPair, DepthPair)> {
    let settings = Settings {
        max_correspondence_distance_m: 0.06,
        kernel: Kernel::Cauchy { scale_m: 0.01 },
        rotation_epsilon_rad: 1e-4,
        translation_epsilon_m: 1e-4,
        ..Settings::default()
    };
    let start = second.start_from_camera.inverse() * first.start_from_camera;
    let mut target = PointMap::new(settings.max_correspondence_distance_m);
    for (id, point) in first.surface.iter().enumerate() {
        target.insert(id as u64, *point);
    }
    let registered = align(&second.surface, &target, &start.inverse(), &settings).ok()?;
    if !registered.converged || registered.inlier_share < MIN_INLIER_SHARE {
        return None;
    }
    let depth_second_from_first = registered.target_from_source.inverse();
    let is_seen = |point: &Vector3<f64>| {
        let moved = depth_second_from_first.transform(point);
        let Some(pixel) = camera
            .project(&moved)
            .filter(|pixel| camera.contains(pixel))
        else {
            return false;
        };
        let (u, v) = (pixel.x.round() as usize, pixel.y.round() as usize);
        let depth = second.depth_m.at(u, v);
        has_depth(depth) && (f64::from(depth) / moved.z - 1.0).abs() <= MAX_DEPTH_DIFFERENCE
    };
    let points = first.colored(is_seen);
    if points.len() < MIN_POINTS {
        return None;
    }
    let aligned = align_images(&first.brightness, &second.brightness, &points, &start)?;
    let velocities = [first.velocity, second.velocity];
    let color = ColorPair::new(
        first.brightness.levels.first()?,
        Arc::clone(image),
        &points,
        aligned.second_from_first,
        velocities,
    );
    let depth_from_color = first.sensor.color_from_depth.inverse().adjoint();
    let depth = DepthPair::new(
        Arc::clone(&first.patches),
        Arc::clone(&second.patches),
        depth_second_from_first,
        velocities.map(|velocity| depth_from_color * velocity),
    );
    Some((color, depth))
}

/// The points of every `cell_px`-th pixel.
fn patch_grid(points: &[SurfacePoint], cell_px: usize, camera: Camera) -> PatchGrid {
    let [width, height] = [camera.width, camera.height].map(|size| size.div_ceil(cell_px));
    let mut patches = Image::filled(width, height, None);
    for point in points {
        let patch = Patch {
            point: point.fitted,
            normal: point.normal,
            row: point.v,
        };
        patches.set(point.u / cell_px, point.v / cell_px, Some(patch));
    }
    PatchGrid {
        camera,
        cell_px,
        patches,
    }
}

/// The most textured point of each cell of the image that lies on a smooth surface, away from its
/// edges, in the depth sensor's axes.
fn textured(
    brightness: &IntensityPyramid,
    depth_m: &Image<f32>,
    camera: &Camera,
) -> Vec<Vector3<f64>> {
    let grid = DepthGrid {
        min_support: 0.9,
        ..DepthGrid::default()
    };
    let Some(image) = brightness.levels.first() else {
        return Vec::new();
    };
    let pixels_per_pixel = camera.width as f64 / image.camera.width as f64;
    let gradient = |u: usize, v: usize| {
        let at = |x: usize| (x as f64 + 0.5) / pixels_per_pixel - 0.5;
        let [_, du, dv] = image.sample(at(u), at(v))?;
        Some(du.hypot(dv))
    };
    let cell = camera.width.div_ceil(CELLS);
    let mut points = Vec::new();
    for v in (0..camera.height).step_by(cell) {
        for u in (0..camera.width).step_by(cell) {
            let places = (0..cell * cell)
                .step_by(2)
                .map(|i| (u + i % cell, v + i / cell));
            let best = places
                .filter_map(|(u, v)| Some((gradient(u, v)?, u, v)))
                .max_by(|a, b| a.0.total_cmp(&b.0));
            let place = best.filter(|(gradient, ..)| *gradient >= MIN_GRADIENT);
            let surface = place.and_then(|(_, u, v)| grid.surface_point(depth_m, camera, u, v));
            points.extend(surface.map(|surface| surface.fitted));
        }
    }
    points
}
