//! One walk through a synthetic room, written in each format: by other crates' writers, and by hand.

#![allow(dead_code, reason = "each test program uses its own part of this")]
#![allow(clippy::unwrap_used, reason = "a test may panic, its helpers too")]

pub mod bag;

use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{Cursor, Write};
use std::path::Path;

use fgs_geom::{Camera, Image, Intrinsics, Se3};
use fgs_synth::{SensorModel, Sequence};
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageBuffer, ImageEncoder, ImageFormat, Luma};
use lzfse_rust::encode_bytes;
use nalgebra::{UnitQuaternion, Vector3};
use serde_json::json;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

pub const FRAMES: usize = 12;
pub const WIDTH: usize = 160;
pub const HEIGHT: usize = 120;

/// Numbers that single precision and millimetres hold exactly.
pub struct Frame {
    pub secs: f64,
    /// What every format stores.
    pub jpeg: Vec<u8>,
    pub color: Image<[u8; 3]>,
    pub depth_mm: Image<u16>,
    pub world_from_camera: Se3,
}

pub struct Walk {
    pub camera: Camera,
    pub frames: Vec<Frame>,
}

/// A camera that is not quite in the middle, so that turned images would be noticed.
pub fn camera(width: usize, height: usize) -> Camera {
    let scale = width as f64 / 160.0;
    let intrinsics = Intrinsics {
        fx: 140.0 * scale,
        fy: 139.0 * scale,
        cx: 80.5 * scale - 0.5,
        cy: 57.25 * scale - 0.5,
    };
    Camera::new(width, height, intrinsics).unwrap()
}

impl Walk {
    pub fn new() -> Self {
        Self::with_size(WIDTH, HEIGHT)
    }

    pub fn with_size(width: usize, height: usize) -> Self {
        let camera = camera(width, height);
        // Slow: a twelfth of the way round the room.
        let sequence = Sequence::new(3, 150, camera, SensorModel::exact());
        let frame = |index: usize| {
            let frame = sequence.frame(index);
            let mut jpeg = Vec::new();
            JpegEncoder::new_with_quality(&mut jpeg, 95)
                .write_image(
                    frame.color.data().as_flattened(),
                    width as u32,
                    height as u32,
                    ExtendedColorType::Rgb8,
                )
                .unwrap();
            let depth_mm = frame.depth_m.map(|depth| (1000.0 * depth).round() as u16);
            Frame {
                secs: 100.0 + index as f64 / 32.0,
                jpeg,
                color: frame.color,
                depth_mm,
                world_from_camera: sequence.world_from_camera(index),
            }
        };
        Self {
            camera,
            frames: (0..FRAMES).map(frame).collect(),
        }
    }

    /// A plain folder in TUM's layout.
    pub fn write_plain(&self, folder: &Path) {
        self.write_camera(folder);
        let [mut colors, mut depths, mut poses] = [const { String::new() }; 3];
        for (index, frame) in self.frames.iter().enumerate() {
            let (color, depth) = (format!("rgb/{index}.jpg"), format!("depth/{index}.png"));
            write(folder, &color, &frame.jpeg);
            write(folder, &depth, &png(&frame.depth_mm));
            writeln!(colors, "{} {color}", frame.secs).unwrap();
            writeln!(depths, "{} {depth}", frame.secs).unwrap();
            let (t, q) = parts(&frame.world_from_camera);
            writeln!(
                poses,
                "{} {} {} {} {} {} {} {}",
                frame.secs, t[0], t[1], t[2], q[0], q[1], q[2], q[3]
            )
            .unwrap();
        }
        write(folder, "rgb.txt", colors.as_bytes());
        write(folder, "depth.txt", depths.as_bytes());
        write(folder, "groundtruth.txt", poses.as_bytes());
    }

    fn write_camera(&self, folder: &Path) {
        let k = self.camera.intrinsics;
        let text = format!(
            "width = {}\nheight = {}\nfx = {:?}\nfy = {:?}\ncx = {:?}\ncy = {:?}\ndepth_scale = 1000.0\n",
            self.camera.width, self.camera.height, k.fx, k.fy, k.cx, k.cy
        );
        write(folder, "camera.toml", text.as_bytes());
    }

    /// Record3D's archive.
    pub fn write_record3d(&self, path: &Path) {
        let k = self.camera.intrinsics;
        let poses = self.frames.iter().map(|frame| {
            let (t, q) = parts(&y_up(&frame.world_from_camera));
            [q[0], q[1], q[2], q[3], t[0], t[1], t[2]]
        });
        let first = &self.frames[0];
        let metadata = json!({
            "w": self.camera.width,
            "h": self.camera.height,
            "dw": first.depth_mm.width(),
            "dh": first.depth_mm.height(),
            "fps": 30,
            "K": [k.fx, 0, 0, 0, k.fy, 0, k.cx, k.cy, 1],
            "cameraType": 1,
            "poses": poses.collect::<Vec<_>>(),
            "perFrameIntrinsicCoeffs": vec![[k.fx, k.fy, k.cx, k.cy]; self.frames.len()],
            "frameTimestamps": self.frames.iter().map(|frame| frame.secs).collect::<Vec<_>>(),
        });
        let mut archive = ZipWriter::new(File::create(path).unwrap());
        let stored = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
        let deflated = stored.compression_method(CompressionMethod::Deflated);
        let mut add = |name: &str, options, bytes: &[u8]| {
            archive.start_file(name, options).unwrap();
            archive.write_all(bytes).unwrap();
        };
        add("metadata", deflated, metadata.to_string().as_bytes());
        // Not in the order of the frames.
        for (index, frame) in self.frames.iter().enumerate().rev() {
            add(&format!("rgbd/{index}.jpg"), stored, &frame.jpeg);
            let depth = frame.depth_mm.data();
            let metres = depth
                .iter()
                .flat_map(|mm| (f32::from(*mm) / 1000.0).to_le_bytes());
            let metres: Vec<u8> = metres.collect();
            let sure: Vec<u8> = depth.iter().map(|mm| 2 * u8::from(*mm > 0)).collect();
            add(&format!("rgbd/{index}.depth"), stored, &lzfse(&metres));
            add(&format!("rgbd/{index}.conf"), stored, &lzfse(&sure));
        }
        archive.finish().unwrap();
    }

    /// Stray Scanner's folder with the images of its video.
    pub fn write_stray(&self, folder: &Path) {
        let k = self.camera.intrinsics;
        let matrix = format!(
            "{}, 0.0, {}\n0.0, {}, {}\n0.0, 0.0, 1.0",
            k.fx, k.cx, k.fy, k.cy
        );
        write(folder, "camera_matrix.csv", matrix.as_bytes());
        write(folder, "rgb.mp4", b"not decoded");
        let mut odometry = String::from("timestamp, frame, x, y, z, qx, qy, qz, qw\n");
        for (index, frame) in self.frames.iter().enumerate() {
            write(folder, &format!("rgb/{index:06}.jpg"), &frame.jpeg);
            write(
                folder,
                &format!("depth/{index:06}.png"),
                &png(&frame.depth_mm),
            );
            let sure = frame.depth_mm.map(|mm| 2 * u8::from(*mm > 0));
            write(folder, &format!("confidence/{index:06}.png"), &png8(&sure));
            let (t, q) = parts(&frame.world_from_camera);
            writeln!(
                odometry,
                "{}, {index:06}, {}, {}, {}, {}, {}, {}, {}",
                frame.secs, t[0], t[1], t[2], q[0], q[1], q[2], q[3]
            )
            .unwrap();
        }
        write(folder, "odometry.csv", odometry.as_bytes());
    }
}

impl Walk {
    /// Polycam's raw data, in a folder.
    pub fn write_polycam(&self, folder: &Path) {
        let k = self.camera.intrinsics;
        for frame in &self.frames {
            let time = (1e6 * frame.secs) as u64;
            let mut camera = json!({
                "fx": k.fx, "fy": k.fy, "cx": k.cx, "cy": k.cy, "blur_score": 30.5,
                "width": self.camera.width, "height": self.camera.height,
            });
            let matrix = y_up(&frame.world_from_camera).matrix();
            for (row, column) in (0..3).flat_map(|row| (0..4).map(move |column| (row, column))) {
                camera[format!("t_{row}{column}")] = matrix[(row, column)].into();
            }
            let sure = frame.depth_mm.map(|mm| 255 * u8::from(*mm > 0));
            let camera = camera.to_string();
            for (name, bytes) in [
                (format!("images/{time}.jpg"), &frame.jpeg),
                (format!("cameras/{time}.json"), &camera.into_bytes()),
                (format!("depth/{time}.png"), &png(&frame.depth_mm)),
                (format!("confidence/{time}.png"), &png8(&sure)),
            ] {
                write(folder, &format!("keyframes/{name}"), bytes);
            }
        }
        write(folder, "mesh_info.json", b"{}");
    }

    /// A nerfstudio folder, whose list is not in the frames' order.
    pub fn write_nerfstudio(&self, folder: &Path) {
        let k = self.camera.intrinsics;
        let mut frames = Vec::new();
        for (index, frame) in self.frames.iter().enumerate().rev() {
            let (color, depth) = (format!("images/{index}.jpg"), format!("depths/{index}.png"));
            write(folder, &color, &frame.jpeg);
            write(folder, &depth, &png(&frame.depth_mm));
            let matrix = y_up(&frame.world_from_camera).matrix().transpose();
            frames.push(json!({
                "file_path": format!("./{color}"),
                "depth_file_path": depth,
                "transform_matrix": matrix.as_slice().chunks(4).collect::<Vec<_>>(),
            }));
        }
        let transforms = json!({
            "camera_model": "OPENCV",
            "w": self.camera.width, "h": self.camera.height,
            "fl_x": k.fx, "fl_y": k.fy, "cx": k.cx + 0.5, "cy": k.cy + 0.5,
            "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0,
            "frames": frames,
        });
        write(folder, "transforms.json", transforms.to_string().as_bytes());
    }
}

impl Walk {
    /// A COLMAP model, as text or binary.
    pub fn write_colmap(&self, folder: &Path, is_text: bool) {
        let k = self.camera.intrinsics;
        let (width, height) = (self.camera.width, self.camera.height);
        let parameters = [k.fx, k.fy, k.cx + 0.5, k.cy + 0.5];
        let [fx, fy, cx, cy] = parameters;
        let cameras = format!("# cameras\n1 PINHOLE {width} {height} {fx} {fy} {cx} {cy}\n");
        let mut cameras_bin = 1_u64.to_le_bytes().to_vec();
        cameras_bin.extend([1_u32, 1].iter().flat_map(|id| id.to_le_bytes()));
        let size = [width as u64, height as u64];
        cameras_bin.extend(size.iter().flat_map(|size| size.to_le_bytes()));
        cameras_bin.extend(parameters.iter().flat_map(|value| value.to_le_bytes()));
        let mut images = String::from("# images\n");
        let mut images_bin = (self.frames.len() as u64).to_le_bytes().to_vec();
        for (index, frame) in self.frames.iter().enumerate().rev() {
            write(folder, &format!("images/left {index}.jpg"), &frame.jpeg);
            write(
                folder,
                &format!("depth/left {index}.png"),
                &png(&frame.depth_mm),
            );
            let (t, q) = parts(&frame.world_from_camera.inverse());
            let pose = [q[3], q[0], q[1], q[2], t[0], t[1], t[2]];
            let numbers = pose.map(|value| value.to_string()).join(" ");
            writeln!(images, "{index} {numbers} 1 left {index}.jpg\n").unwrap();
            images_bin.extend((index as u32).to_le_bytes());
            images_bin.extend(pose.iter().flat_map(|value| value.to_le_bytes()));
            images_bin.extend(1_u32.to_le_bytes());
            images_bin.extend(format!("left {index}.jpg\0").bytes());
            // Points that it saw.
            images_bin.extend((index as u64).to_le_bytes());
            images_bin.extend(vec![7; 24 * index]);
        }
        if is_text {
            write(folder, "sparse/0/cameras.txt", cameras.as_bytes());
            write(folder, "sparse/0/images.txt", images.as_bytes());
        } else {
            write(folder, "sparse/0/cameras.bin", &cameras_bin);
            write(folder, "sparse/0/images.bin", &images_bin);
        }
    }
}

/// Position and quaternion, xyzw.
fn parts(pose: &Se3) -> ([f64; 3], [f64; 4]) {
    let (t, q) = (pose.translation, pose.rotation.coords);
    ([t.x, t.y, t.z], [q.x, q.y, q.z, q.w])
}

/// In the axes of ARKit: x right, y up, z backward.
pub fn y_up(pose: &Se3) -> Se3 {
    let turn = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(0.0, 1.0, 0.0, 0.0));
    *pose * Se3::new(turn, Vector3::zeros())
}

pub fn write(folder: &Path, name: &str, bytes: &[u8]) {
    let path = folder.join(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, bytes).unwrap();
}

pub fn png(image: &Image<u16>) -> Vec<u8> {
    let (width, height) = (image.width() as u32, image.height() as u32);
    let image: ImageBuffer<Luma<u16>, _> =
        ImageBuffer::from_raw(width, height, image.data().to_vec()).unwrap();
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, ImageFormat::Png).unwrap();
    bytes.into_inner()
}

pub fn png8(image: &Image<u8>) -> Vec<u8> {
    let (width, height) = (image.width() as u32, image.height() as u32);
    let image: ImageBuffer<Luma<u8>, _> =
        ImageBuffer::from_raw(width, height, image.data().to_vec()).unwrap();
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, ImageFormat::Png).unwrap();
    bytes.into_inner()
}

pub fn lzfse(bytes: &[u8]) -> Vec<u8> {
    let mut encoded = Vec::new();
    encode_bytes(bytes, &mut encoded).unwrap();
    encoded
}
