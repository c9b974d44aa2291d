//! Publishes a synthetic room as a RealSense camera's topics: to try `fgs run --camera-source ros2:/camera`
//! without a camera, and for tests.
//!
//! Usage: `synthetic_camera WIDTH HEIGHT RATE FRAMES`. It renders so many frames, which takes longer than
//! showing them, waits for who reads the topics, and publishes the frames, RATE a second. Stamps are those
//! of 30 frames a second, the first of them a whole second.

use std::env;
use std::error::Error;
use std::thread::sleep;
use std::time::{Duration, Instant, SystemTime};

use fgs_geom::{Camera, RgbdFrame};
use fgs_ros2::{CameraInfo, Domain, Header, Image, RegionOfInterest, Ros2Node, Stamp};
use fgs_synth::{SensorModel, Sequence, kinect_camera};

const COLOR: &str = "/camera/color/image_raw";
const DEPTH: &str = "/camera/aligned_depth_to_color/image_raw";
const INFO: &str = "/camera/color/camera_info";

/// The room and the way through it.
const SEED: u64 = 1;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = env::args()
        .skip(1)
        .map(|argument| argument.parse::<usize>());
    let arguments: Vec<usize> = arguments.collect::<Result<_, _>>()?;
    let &[width, height, rate, frames] = arguments.as_slice() else {
        return Err("usage: synthetic_camera WIDTH HEIGHT RATE FRAMES".into());
    };
    let camera = kinect_camera(width, height)?;
    let sequence = Sequence::new(SEED, frames, camera, SensorModel::exact());
    let frames: Vec<RgbdFrame> = sequence.frames().collect();
    let domain = Domain::of_environment()?;
    let mut node = Ros2Node::new(&domain, "synthetic_camera")?;
    let color = node.publisher(COLOR, ("sensor_msgs", "Image"))?;
    let depth = node.publisher(DEPTH, ("sensor_msgs", "Image"))?;
    let infos = node.publisher(INFO, ("sensor_msgs", "CameraInfo"))?;
    while ![COLOR, DEPTH, INFO]
        .iter()
        .all(|topic| domain.is_read(topic))
    {
        sleep(Duration::from_millis(10));
    }
    let begin = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH)?;
    let period = Duration::from_secs_f64(1.0 / rate as f64);
    for frame in &frames {
        let start = Instant::now();
        let header = Header {
            stamp: Stamp::of(begin.as_secs() as f64 + frame.timestamp_secs),
            frame_id: "camera_color_optical_frame".into(),
        };
        infos.publish(info(&camera, header.clone()))?;
        color.publish(color_image(frame, header.clone()))?;
        depth.publish(depth_image(frame, header))?;
        sleep(period.saturating_sub(start.elapsed()));
    }
    // For those who have not taken the last ones.
    sleep(Duration::from_secs(1));
    Ok(())
}

fn info(camera: &Camera, header: Header) -> CameraInfo {
    let k = camera.intrinsics;
    CameraInfo {
        header,
        height: camera.height as u32,
        width: camera.width as u32,
        distortion_model: "plumb_bob".into(),
        d: vec![0.0; 5],
        k: [k.fx, 0.0, k.cx, 0.0, k.fy, k.cy, 0.0, 0.0, 1.0],
        r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: [
            k.fx, 0.0, k.cx, 0.0, 0.0, k.fy, k.cy, 0.0, 0.0, 0.0, 1.0, 0.0,
        ],
        binning_x: 0,
        binning_y: 0,
        roi: RegionOfInterest::default(),
    }
}

fn color_image(frame: &RgbdFrame, header: Header) -> Image {
    let data = frame.color.data().as_flattened().to_vec();
    image(frame, header, "rgb8", data)
}

/// Whole millimetres.
fn depth_image(frame: &RgbdFrame, header: Header) -> Image {
    let depths = frame.depth_m.data().iter();
    let data = depths.flat_map(|depth| ((1000.0 * depth).round() as u16).to_le_bytes());
    image(frame, header, "16UC1", data.collect())
}

fn image(frame: &RgbdFrame, header: Header, encoding: &str, data: Vec<u8>) -> Image {
    let height = frame.camera.height;
    Image {
        header,
        height: height as u32,
        width: frame.camera.width as u32,
        encoding: encoding.into(),
        is_bigendian: 0,
        step: (data.len() / height) as u32,
        data,
    }
}
