//! A synthetic room is tracked and mapped; the mesh of the map lies on the room's true surfaces, faces
//! the camera, has their colours, and covers what the keyframes saw.

#![allow(clippy::unwrap_used, reason = "a test may panic, its helpers too")]

use std::collections::HashSet;
use std::ops::ControlFlow;

use fgs_export::{ExportError, Mesh, surface_mesh};
use fgs_geom::{RgbdFrame, Se3, View};
use fgs_slam::{Execution, Slam, SlamConfig, SlamOutput, model_settings};
use fgs_splat::CpuModel;
use fgs_synth::{SensorModel, Sequence, kinect_camera};
use nalgebra::Vector3;

const FRAMES: usize = 24;
const VOXEL_M: f64 = 0.02;

/// The room's frames, and what the system made of them.
struct Session {
    frames: Vec<RgbdFrame>,
    /// True poses, in the run's world.
    poses: Vec<Se3>,
    output: SlamOutput,
    views: Vec<View>,
}

impl Session {
    fn new() -> Self {
        let camera = kinect_camera(320, 240).unwrap();
        let sequence = Sequence::new(3, FRAMES, camera, SensorModel::exact());
        let mut config = SlamConfig::default();
        config.mapping.iterations_per_frame = 2.0;
        let model = Box::new(CpuModel::new(model_settings(&config.mapping)));
        let mut slam = Slam::new(&camera, &config, Execution::Lockstep, model).unwrap();
        let frames: Vec<RgbdFrame> = sequence.frames().collect();
        for frame in &frames {
            slam.push(frame.clone()).unwrap();
        }
        let output = slam.finish();
        let world_from_room = sequence.world_from_camera(0).inverse();
        let poses = (0..FRAMES).map(|i| world_from_room * sequence.world_from_camera(i));
        let views = output.keyframes.iter().map(|keyframe| View {
            camera,
            world_from_camera: keyframe.world_from_camera,
        });
        Self {
            poses: poses.collect(),
            views: views.collect(),
            frames,
            output,
        }
    }

    fn mesh(&self, threads: usize) -> Mesh {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let gaussians = &self.output.gaussians;
        pool.install(|| {
            surface_mesh(gaussians, &self.views, VOXEL_M, &mut || {
                ControlFlow::Continue(())
            })
            .unwrap()
        })
    }

    /// Distance of a point to the true surface where frame i shows it, along its normal, metres, and
    /// that pixel; `None` if the frame does not show the surface there.
    fn distance_m(&self, i: usize, point: &Vector3<f64>) -> Option<(f64, [usize; 2])> {
        let (frame, camera) = (&self.frames[i], &self.frames[i].camera);
        let point = self.poses[i].inverse().transform(point);
        let pixel = camera.project(&point)?;
        let (u, v) = (pixel.x.floor() as usize, pixel.y.floor() as usize);
        if pixel.x < 0.0 || pixel.y < 0.0 || u + 1 >= camera.width || v + 1 >= camera.height {
            return None;
        }
        let [a, b, c] = [(u, v), (u + 1, v), (u, v + 1)]
            .map(|(u, v)| camera.unproject(u as f64, v as f64, f64::from(frame.depth_m.at(u, v))));
        if (point.z - a.z).abs() > 0.1 || (b.z - a.z).abs() > 0.1 || (c.z - a.z).abs() > 0.1 {
            return None;
        }
        let normal = (b - a).cross(&(c - a)).normalize();
        Some((normal.dot(&(point - a)).abs(), [u, v]))
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

#[test]
fn the_mesh_of_a_room_is_the_room() {
    let session = Session::new();
    let mesh = session.mesh(2);
    assert!(
        mesh == session.mesh(1),
        "the number of threads does not matter"
    );
    assert!(
        mesh.triangles.len() > 10_000,
        "{} triangles",
        mesh.triangles.len()
    );

    let (mut distances, mut color_errors, mut backward) = (Vec::new(), Vec::new(), 0);
    for (i, position) in mesh.positions.iter().enumerate() {
        let position = Vector3::from(*position).cast::<f64>();
        let seen = (0..FRAMES).filter_map(|f| {
            let (distance, pixel) = session.distance_m(f, &position)?;
            Some((distance, f, pixel))
        });
        let Some((distance, f, [u, v])) = seen.min_by(|a, b| a.0.total_cmp(&b.0)) else {
            distances.push(f64::INFINITY);
            continue;
        };
        distances.push(distance);
        let normal = Vector3::from(mesh.normals[i]).cast::<f64>();
        assert!((normal.norm() - 1.0).abs() <= 1e-5);
        backward += usize::from(normal.dot(&(session.poses[f].translation - position)) < 0.0);
        let color = session.frames[f]
            .color
            .at(u, v)
            .map(|value| f64::from(value) / 255.0);
        let errors = (0..3).map(|axis| (color[axis] - f64::from(mesh.colors[i][axis])).abs());
        color_errors.push(errors.sum::<f64>() / 3.0);
    }
    let vertices = mesh.positions.len();
    println!("{vertices} vertices, {} triangles", mesh.triangles.len());
    let far = distances
        .iter()
        .filter(|distance| **distance > 0.02)
        .count();
    let (distance, color) = (median(distances), median(color_errors));
    println!("median {distance} m, {far} farther than 2 cm; colour {color}; {backward} backward");
    assert!(distance <= 0.005, "median distance {distance} m");
    assert!(
        far * 20 <= vertices,
        "{far} of {vertices} are farther than 2 cm"
    );
    assert!(color <= 0.04, "median colour error {color}");
    assert!(
        backward * 100 <= vertices,
        "{backward} of {vertices} face away"
    );

    let flipped = mesh.triangles.iter().filter(|triangle| {
        let [a, b, c] = triangle.map(|vertex| Vector3::from(mesh.positions[vertex as usize]));
        let normals = triangle.map(|vertex| Vector3::from(mesh.normals[vertex as usize]));
        (b - a).cross(&(c - a)).dot(&normals.iter().sum()) < 0.0
    });
    let flipped = flipped.count();
    assert!(
        flipped * 100 <= mesh.triangles.len(),
        "{flipped} triangles are turned around"
    );

    // Patches of neighbouring blocks are joined: an edge inside of the surface has two triangles.
    let mut edges = HashSet::new();
    for [a, b, c] in &mesh.triangles {
        for edge in [(a, b), (b, c), (c, a)] {
            edges.insert(edge);
        }
    }
    let border = edges
        .iter()
        .filter(|(a, b)| !edges.contains(&(*b, *a)))
        .count();
    println!("{border} of {} edges at a border", edges.len());
    assert!(
        border * 50 <= edges.len(),
        "{border} of {} edges have one triangle",
        edges.len()
    );

    // What the last keyframe sees is there.
    let cell = |point: Vector3<f64>| point.map(|x| (x / (2.0 * VOXEL_M)).floor() as i64);
    let near: HashSet<Vector3<i64>> = mesh
        .positions
        .iter()
        .map(|position| cell(Vector3::from(*position).cast()))
        .collect();
    let last = session.output.keyframes.last().unwrap().index.0;
    let frame = &session.frames[last];
    let (mut covered, mut all) = (0, 0);
    for v in (0..240).step_by(3) {
        for u in (0..320).step_by(3) {
            let depth_m = f64::from(frame.depth_m.at(u, v));
            let point = frame.camera.unproject(u as f64, v as f64, depth_m);
            let center = cell(session.poses[last].transform(&point));
            let around =
                (0..27).map(|i| center + Vector3::new(i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1));
            covered += usize::from(around.into_iter().any(|cell| near.contains(&cell)));
            all += 1;
        }
    }
    println!("{covered} of {all} pixels covered");
    assert!(covered * 10 >= all * 8, "{covered} of {all}");
}

#[test]
fn a_run_without_keyframes_is_refused() {
    let none = surface_mesh(&Default::default(), &[], VOXEL_M, &mut || {
        ControlFlow::Continue(())
    })
    .unwrap_err();
    assert!(matches!(none, ExportError::NoKeyframes));
}
