//! How long tracking one frame takes, beside small_gicp's cases: frame to frame, and frame to a
//! map of ten frames thinned to 1 cm. Best of many runs.
//!
//! `cargo run --release -p fgs_gicp --example speed -- DIR [FIRST_FRAME]`

#[path = "../odometry/sequence.rs"]
mod sequence;

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result};
use fgs_geom::{Camera, Image, Se3};
use fgs_gicp::{DepthGrid, MIN_EIGENVALUE, Point, PointMap, Settings, align};

use sequence::Sequence;

const RUNS: usize = 100;

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let dir = arguments
        .first()
        .context("usage: speed DIR [FIRST_FRAME]")?;
    let first: usize = arguments.get(1).map_or(Ok(100), |text| text.parse())?;
    let sequence = Sequence::open(Path::new(dir))?;
    let camera = sequence.camera;
    let read = |i: usize| sequence.read_depth(&sequence.depth_files[i]);
    let source = read(first + 10)?;
    let pose = |i: usize| sequence.world_from_camera[i];
    for stride_px in [10, 5, 3] {
        let grid = DepthGrid {
            stride_px,
            ..DepthGrid::default()
        };
        let mut previous = PointMap::new(0.045);
        add(
            &mut previous,
            &points(&grid, &read(first + 9)?, &camera),
            &Se3::identity(),
            0.0,
        );
        time(
            "frame to frame",
            &grid,
            &source,
            &camera,
            &previous,
            &Se3::identity(),
        )?;
        let mut map = PointMap::new(0.045);
        for i in first..first + 10 {
            add(&mut map, &points(&grid, &read(i)?, &camera), &pose(i), 0.01);
        }
        time(
            "frame to map",
            &grid,
            &source,
            &camera,
            &map,
            &pose(first + 9),
        )?;
    }
    Ok(())
}

fn points(grid: &DepthGrid, depth_m: &Image<f32>, camera: &Camera) -> Vec<Point> {
    let surface = grid.surface_points(depth_m, camera);
    surface
        .iter()
        .map(|point| point.disk(MIN_EIGENVALUE, 0.0))
        .collect()
}

fn add(map: &mut PointMap, points: &[Point], world_from_camera: &Se3, spacing_m: f32) {
    for point in points {
        let point = point.transformed(world_from_camera);
        if spacing_m <= 0.0 || map.nearest(&point.position, spacing_m).is_none() {
            map.insert(map.len() as u64, point);
        }
    }
}

fn time(
    what: &str,
    grid: &DepthGrid,
    depth_m: &Image<f32>,
    camera: &Camera,
    map: &PointMap,
    start: &Se3,
) -> Result<()> {
    let (mut preparation, mut registration) = (f64::INFINITY, f64::INFINITY);
    let mut iterations = 0;
    let mut source = Vec::new();
    for _ in 0..RUNS {
        let begin = Instant::now();
        source = points(grid, depth_m, camera);
        preparation = preparation.min(begin.elapsed().as_secs_f64());
        let begin = Instant::now();
        iterations = align(&source, map, start, &Settings::default())?.iterations;
        registration = registration.min(begin.elapsed().as_secs_f64());
    }
    println!(
        "stride {} {what}: {} / {} points, {:.2} + {:.2} = {:.2} ms, {iterations} iterations",
        grid.stride_px,
        source.len(),
        map.len(),
        1e3 * preparation,
        1e3 * registration,
        1e3 * (preparation + registration),
    );
    Ok(())
}
