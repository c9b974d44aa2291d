//! Segmentation and registration.

use std::collections::HashSet;
use std::hint::black_box;

use anyhow::ensure;
use fgs_geom::{Camera, Image, Se3};
use fgs_gicp::{DepthGrid, MIN_EIGENVALUE, Point, PointMap, Settings, align};
use fgs_slam::frequency::{FrequencySegmenter, FrequencySettings};
use nalgebra::Vector3;

use super::input::Input;
use super::stage::{Bench, Stage};
use crate::console::Console;

/// Pixels between the points that are registered.
const STRIDE_PX: usize = 5;
/// A map holds so many frames at most, and one point in each cube of this side.
const MAP_FRAMES: usize = 10;
const VOXEL_M: f32 = 0.01;
/// Side of the point map's cells: about three times the correspondence distance is fastest.
const CELL_M: f32 = 0.1;
/// A registration that is further off, on average over the points, is wrong.
const MAX_ERROR_M: f64 = 0.02;

/// Hands every stage to `bench`.
pub fn bench(input: &Input, console: Console, bench: &mut Bench<'_>) -> anyhow::Result<()> {
    segmentation(input, bench)?;
    pair_errors(input, console)?;
    registration(input, 1, bench)?;
    registration(input, MAP_FRAMES, bench)
}

fn segmentation(input: &Input, bench: &mut Bench<'_>) -> anyhow::Result<()> {
    let color = &input.frames[0].color;
    let (width, height) = (color.width(), color.height());
    let settings = FrequencySettings { clahe: true };
    let mut segmenter = FrequencySegmenter::new(width, height, settings);
    let pixels = (width * height) as f64;
    // Both axes of the blur, 5 sigma = 5 side / (2 pi side / 20) = 16 pixel pairs, on average.
    let flops = 2.0 * 16.0 * 3.0 * pixels;
    bench(Stage {
        name: "segmentation",
        work: format!("{width}x{height}, CLAHE"),
        bytes: 4.0 * pixels,
        flops,
        check: Box::new(|| {
            let mut segmenter = FrequencySegmenter::new(width, height, settings);
            let share = |mask: Image<bool>| {
                mask.data().iter().filter(|high| **high).count() as f64 / pixels
            };
            let detail = share(segmenter.segment(color));
            ensure!(
                detail > 0.001 && detail < 0.6,
                "{detail} of the pixels are detail"
            );
            let flat = share(segmenter.segment(&Image::filled(width, height, [90; 3])));
            ensure!(flat == 0.0, "a flat image has detail");
            Ok(())
        }),
        run: Box::new(move || {
            black_box(segmenter.segment(color));
        }),
    })
}

fn grid() -> DepthGrid {
    DepthGrid {
        stride_px: STRIDE_PX,
        ..DepthGrid::default()
    }
}

fn points(grid: &DepthGrid, depth_m: &Image<f32>, camera: &Camera) -> Vec<Point> {
    let surface = grid.surface_points(depth_m, camera);
    surface
        .iter()
        .map(|point| point.disk(MIN_EIGENVALUE, 0.0))
        .collect()
}

/// The target of a registration: frames at their known poses; of several, one point to a voxel.
fn target(input: &Input, frames: std::ops::Range<usize>) -> PointMap {
    let several = frames.len() > 1;
    let mut taken = HashSet::new();
    let mut map = PointMap::new(CELL_M);
    for i in frames {
        let frame = &input.frames[i];
        for point in points(&grid(), &frame.depth_m, &frame.camera) {
            let point = point.transformed(&input.world_from_camera[i]);
            let voxel = point.position.map(|x| (x / VOXEL_M).floor() as i32);
            if !several || taken.insert(voxel) {
                map.insert(map.len() as u64, point);
            }
        }
    }
    map
}

/// Root mean square distance between the points under two poses, metres.
fn displacement_m(points: &[Point], a: &Se3, b: &Se3) -> f64 {
    let difference = |point: &Point| {
        let p: Vector3<f64> = point.position.cast();
        (a.transform(&p) - b.transform(&p)).norm_squared()
    };
    (points.iter().map(difference).sum::<f64>() / points.len() as f64).sqrt()
}

/// Says how far neighbouring frames are registered from their known motion.
fn pair_errors(input: &Input, console: Console) -> anyhow::Result<()> {
    let mut errors_m = Vec::new();
    for i in 1..input.frames.len() {
        let frame = &input.frames[i];
        let source = points(&grid(), &frame.depth_m, &frame.camera);
        let map = target(input, i - 1..i);
        let start = &input.world_from_camera[i - 1];
        let found = align(&source, &map, start, &Settings::default())?.target_from_source;
        errors_m.push(displacement_m(&source, &found, &input.world_from_camera[i]));
    }
    errors_m.sort_by(f64::total_cmp);
    let median_mm = 1e3 * errors_m[errors_m.len() / 2];
    let pairs = errors_m.len();
    console.say(format!(
        "{:<10} registration of {pairs} pairs of neighbours, stride {STRIDE_PX}: median error {median_mm:.3} mm",
        input.name
    ));
    console.event(
        "registration_error",
        serde_json::json!({"input": input.name, "pairs": pairs, "median_mm": median_mm}),
    );
    Ok(())
}

fn registration(input: &Input, map_frames: usize, bench: &mut Bench<'_>) -> anyhow::Result<()> {
    let last = (input.frames.len() - 1).min(MAP_FRAMES);
    let map = target(input, last.saturating_sub(map_frames)..last);
    let frame = &input.frames[last];
    let start = &input.world_from_camera[last - 1];
    let grid = grid();
    let source = points(&grid, &frame.depth_m, &frame.camera);
    let alignment = align(&source, &map, start, &Settings::default())?;
    let (source_len, iterations) = (source.len() as f64, alignment.iterations as f64);
    bench(Stage {
        name: if map_frames == 1 {
            "registration to a frame"
        } else {
            "registration to a map"
        },
        work: format!(
            "{} points to {}, {} iterations",
            source.len(),
            map.len(),
            alignment.iterations
        ),
        // Depth once; per iteration each point and its partner, 40 bytes each.
        bytes: 4.0 * frame.depth_m.data().len() as f64 + 80.0 * source_len * iterations,
        // 25 pixels of 12 operations a point; per iteration a pair's covariance, its inverse and
        // the normal equations: 300.
        flops: source_len * (300.0 + 300.0 * iterations),
        check: Box::new(move || {
            let truth = &input.world_from_camera[last];
            let error_m = displacement_m(&source, &alignment.target_from_source, truth);
            ensure!(error_m <= MAX_ERROR_M, "off by {error_m} m");
            Ok(())
        }),
        run: Box::new(move || {
            let source = points(&grid, &frame.depth_m, &frame.camera);
            black_box(align(&source, &map, start, &Settings::default()).is_ok());
        }),
    })
}
