//! A box-shaped room with two blocks, rendered exactly: depth and a brightness pattern.

use fgs_geom::{Camera, FrameIndex, Image, Intrinsics, RgbdFrame, Se3};
use nalgebra::{Vector3, Vector6};

/// Corners of the room and of the blocks, metres; the camera starts at the origin looking along z.
const BOXES: [[[f64; 3]; 2]; 3] = [
    [[-1.1, -0.9, -1.0], [1.3, 1.3, 3.1]],
    [[-0.9, 0.1, 1.7], [-0.3, 1.3, 2.2]],
    [[0.4, -0.6, 1.4], [0.8, 0.5, 1.8]],
];

/// Not square, off-centre.
pub fn camera() -> Camera {
    let intrinsics = Intrinsics {
        fx: 180.0,
        fy: 184.0,
        cx: 101.0,
        cy: 85.0,
    };
    Camera::new(216, 160, intrinsics).unwrap()
}

/// A hand-held walk that turns about all three axes, about 1 degree and 1 cm per frame.
pub fn world_from_camera(index: usize) -> Se3 {
    world_from_camera_at(index as f64 / 30.0)
}

/// The same walk at a time in seconds.
pub fn world_from_camera_at(t: f64) -> Se3 {
    Se3::exp(&Vector6::new(
        0.2 * (2.0 * t).sin(),
        0.3 * (1.7 * t).sin(),
        0.15 * (2.3 * t).sin(),
        0.25 * (1.5 * t).sin(),
        0.1 * (2.1 * t).sin(),
        0.2 * (1.9 * t).sin(),
    ))
}

/// Frame `index` of the walk.
pub fn frame(index: usize) -> RgbdFrame {
    let pose = world_from_camera(index);
    frame_of_sensors(index, &pose, &pose)
}

/// A frame whose colour and depth were measured from different poses.
pub fn frame_of_sensors(index: usize, world_from_color: &Se3, world_from_depth: &Se3) -> RgbdFrame {
    frame_of_rows(index, |_| *world_from_color, |_| *world_from_depth)
}

/// A frame each row of whose colour and depth was measured from another pose.
pub fn frame_of_rows(
    index: usize,
    world_from_color: impl Fn(usize) -> Se3,
    world_from_depth: impl Fn(usize) -> Se3,
) -> RgbdFrame {
    let color = see(world_from_color).map(|pixel| pixel.1);
    let depth_m = see(world_from_depth).map(|pixel| pixel.0);
    RgbdFrame::new(
        FrameIndex(index),
        index as f64 / 30.0,
        color,
        depth_m,
        camera(),
    )
    .unwrap()
}

/// Depth and colour of every pixel, given the pose of its row.
fn see(pose: impl Fn(usize) -> Se3) -> Image<(f32, [u8; 3])> {
    let camera = camera();
    Image::from_fn(camera.width, camera.height, |u, v| {
        let pose = pose(v);
        let direction = pose.rotation * camera.ray(u as f64, v as f64);
        let hit = |[low, high]: &[[f64; 3]; 2]| meet(&pose.translation, &direction, low, high);
        let depth = BOXES
            .iter()
            .enumerate()
            .filter_map(|(i, b)| Some((hit(b)?, i)));
        let (depth, thing) = depth.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
        let p = pose.translation + depth * direction;
        let pattern = (9.0 * p.x).sin() * (8.0 * p.y).sin() + (7.0 * p.z + 5.0 * p.x).sin();
        let brightness = [90.0, 160.0, 200.0][thing] + 20.0 * pattern;
        (depth as f32, [brightness as u8; 3])
    })
}

/// The first face of a box that a ray meets, from outside or inside.
fn meet(
    origin: &Vector3<f64>,
    direction: &Vector3<f64>,
    low: &[f64; 3],
    high: &[f64; 3],
) -> Option<f64> {
    let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
    for axis in 0..3 {
        let faces = [low[axis], high[axis]].map(|face| (face - origin[axis]) / direction[axis]);
        enter = enter.max(faces[0].min(faces[1]));
        leave = leave.min(faces[0].max(faces[1]));
    }
    let first = if enter > 0.0 { enter } else { leave };
    (enter < leave && first > 0.0).then_some(first)
}
