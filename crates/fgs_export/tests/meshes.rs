//! Points, trajectories and meshes in files, read back by other people's readers where there are any.

#![allow(clippy::unwrap_used, reason = "a test may panic, its helpers too")]

use fgs_data::Trajectory;
use fgs_export::{
    Mesh, surface_points, write_kitti, write_mesh_glb, write_mesh_obj, write_mesh_ply, write_points,
};
use fgs_geom::Se3;
use fgs_splat::{Gaussian, Gaussians};
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{DefaultElement, Property};

/// A corner of a box.
fn corner() -> Mesh {
    let third = 1.0 / 3.0_f32.sqrt();
    Mesh {
        positions: vec![
            [0.0, 0.25, 2.0],
            [1.0, 0.0, 2.5],
            [0.0, 1.0, 2.5],
            [-1.0, 0.0, 3.0],
        ],
        normals: vec![
            [0.0, 0.0, -1.0],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [third; 3],
        ],
        colors: vec![[0.0, 0.5, 1.0], [0.2, 0.4, 0.6], [1.0; 3], [0.04, 0.0, 0.7]],
        triangles: vec![[0, 2, 1], [0, 3, 2]],
    }
}

fn close(a: &[f32], b: &[f32], tolerance: f32) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= tolerance)
}

fn floats(row: &DefaultElement, names: [&str; 3]) -> [f32; 3] {
    names.map(|name| match row[name] {
        Property::Float(value) => value,
        ref other => panic!("{name} is {other:?}"),
    })
}

fn color(row: &DefaultElement) -> [u8; 3] {
    ["red", "green", "blue"].map(|name| match row[name] {
        Property::UChar(value) => value,
        ref other => panic!("{name} is {other:?}"),
    })
}

const XYZ: [&str; 3] = ["x", "y", "z"];

#[test]
fn points_are_opaque_and_measured() {
    let mut gaussians = Gaussians::default();
    for (x, opacity, rgb) in [
        (0.0, 0.9, [0.11, 0.502, 1.5]),
        (1.0, 0.4, [0.0; 3]),
        (2.0, 0.9, [0.0; 3]),
        (3.0, 0.6, [1.0, -0.2, 0.251]),
    ] {
        gaussians.push(&Gaussian {
            mean: [x, 2.0, 3.0],
            quat: [1.0, 0.0, 0.0, 0.0],
            scales: [0.01; 3],
            opacity,
            rgb,
        });
    }
    gaussians.inferred[2] = true;
    let mut bytes = Vec::new();
    write_points(&mut bytes, &surface_points(&gaussians)).unwrap();
    let ply = Parser::<DefaultElement>::new()
        .read_ply(&mut bytes.as_slice())
        .unwrap();
    let rows = &ply.payload["vertex"];
    let read: Vec<_> = rows
        .iter()
        .map(|row| (floats(row, XYZ), color(row)))
        .collect();
    let expected = [
        ([0.0, 2.0, 3.0], [28, 128, 255]),
        ([3.0, 2.0, 3.0], [255, 0, 64]),
    ];
    assert_eq!(read, expected);
}

#[test]
fn kitti_rows_are_poses() {
    let poses = [
        Se3::identity(),
        Se3::from_wxyz([0.5, -0.5, 0.5, 0.5], [1.0, -2.0, 0.125]).unwrap(),
    ];
    let stamped = poses.iter().enumerate().map(|(i, pose)| (i as f64, *pose));
    let trajectory = Trajectory::new(stamped).unwrap();
    let mut text = Vec::new();
    write_kitti(&mut text, &trajectory).unwrap();
    let text = String::from_utf8(text).unwrap();
    assert_eq!(text.lines().next(), Some("1 0 0 0 0 1 0 0 0 0 1 0"));
    let numbers: Vec<f64> = text
        .lines()
        .nth(1)
        .unwrap()
        .split(' ')
        .map(|x| x.parse().unwrap())
        .collect();
    // Of the camera's axes, x goes to -z: the first column of the rotation.
    let columns = [
        [0.0, 0.0, -1.0],
        [-1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [1.0, -2.0, 0.125],
    ];
    for (i, number) in numbers.iter().enumerate() {
        let pose = poses[1].matrix()[(i / 4, i % 4)];
        assert!((number - pose).abs() <= 1e-12, "{i}");
        assert!(
            (number - columns[i % 4][i / 4]).abs() <= 1e-12,
            "{i}: {number}"
        );
    }
}

#[test]
fn ply() {
    let mesh = corner();
    let mut bytes = Vec::new();
    write_mesh_ply(&mut bytes, &mesh).unwrap();
    let ply = Parser::<DefaultElement>::new()
        .read_ply(&mut bytes.as_slice())
        .unwrap();
    for (i, row) in ply.payload["vertex"].iter().enumerate() {
        assert_eq!(floats(row, XYZ), mesh.positions[i]);
        assert_eq!(floats(row, ["nx", "ny", "nz"]), mesh.normals[i]);
        let read = color(row).map(|value| f32::from(value) / 255.0);
        assert!(close(&read, &mesh.colors[i], 0.51 / 255.0));
    }
    let faces: Vec<_> = ply.payload["face"]
        .iter()
        .map(|row| row["vertex_indices"].clone())
        .collect();
    let expected = mesh
        .triangles
        .iter()
        .map(|triangle| Property::ListUInt(triangle.to_vec()));
    assert_eq!(faces, expected.collect::<Vec<_>>());
}

#[test]
fn obj() {
    let mesh = corner();
    let mut text = Vec::new();
    write_mesh_obj(&mut text, &mesh).unwrap();
    let no_materials = |_: &std::path::Path| Err(tobj::LoadError::OpenFileFailed);
    let (models, _) =
        tobj::load_obj_buf(&mut text.as_slice(), &tobj::GPU_LOAD_OPTIONS, no_materials).unwrap();
    let read = &models[0].mesh;
    // The reader numbers vertices by their first use.
    for (triangle, indices) in mesh.triangles.iter().zip(read.indices.chunks(3)) {
        for (vertex, index) in triangle.iter().zip(indices) {
            let (vertex, at) = (
                *vertex as usize,
                3 * *index as usize..3 * *index as usize + 3,
            );
            assert_eq!(read.positions[at.clone()], mesh.positions[vertex]);
            assert!(close(
                &read.normals[at.clone()],
                &mesh.normals[vertex],
                1e-4
            ));
            assert!(close(&read.vertex_color[at], &mesh.colors[vertex], 1e-4));
        }
    }
    assert_eq!(read.indices.len(), 3 * mesh.triangles.len());
}

#[test]
fn glb_has_y_up_and_linear_colors() {
    let mesh = corner();
    let mut bytes = Vec::new();
    write_mesh_glb(&mut bytes, &mesh).unwrap();
    let gltf = gltf::Gltf::from_slice(&bytes).unwrap();
    let primitive = gltf.meshes().next().unwrap().primitives().next().unwrap();
    assert_eq!(primitive.mode(), gltf::mesh::Mode::Triangles);
    let blob = gltf.blob.as_deref().unwrap();
    let reader = primitive.reader(|_| Some(blob));
    let turned = |[x, y, z]: &[f32; 3]| [*x, -y, -z];
    let positions: Vec<_> = reader.read_positions().unwrap().collect();
    assert_eq!(
        positions,
        mesh.positions.iter().map(turned).collect::<Vec<_>>()
    );
    let normals: Vec<_> = reader.read_normals().unwrap().collect();
    assert_eq!(normals, mesh.normals.iter().map(turned).collect::<Vec<_>>());
    let indices: Vec<_> = reader.read_indices().unwrap().into_u32().collect();
    assert_eq!(indices, mesh.triangles.as_flattened());
    // 0.5, 0.2 and 0.04 of sRGB.
    let colors: Vec<_> = reader.read_colors(0).unwrap().into_rgba_f32().collect();
    assert!(
        close(&colors[0], &[0.0, 0.214_041, 1.0, 1.0], 2e-5),
        "{:?}",
        colors[0]
    );
    assert!(close(
        &colors[1],
        &[0.033_105, 0.132_868, 0.318_547, 1.0],
        2e-5
    ));
    assert!(close(&colors[3][..1], &[0.04 / 12.92], 2e-5));
    let bounds = primitive.bounding_box();
    assert_eq!(
        (bounds.min, bounds.max),
        ([-1.0, -1.0, -3.0], [1.0, 0.0, -2.0])
    );
}
