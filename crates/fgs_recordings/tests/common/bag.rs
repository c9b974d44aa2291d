//! ROS 2 bags, by the `mcap` crate's writer; messages are put together by hand.

use std::collections::{BTreeMap, HashSet};
use std::fs::File;
use std::ops::Range;
use std::path::Path;

use fgs_geom::Image;
use mcap::records::MessageHeader;
use mcap::{Compression, WriteOptions};

use super::{Frame, Walk, png};

/// How images are sent.
#[derive(Clone, Copy)]
pub enum Transport {
    /// JPEG, and depth as 16-bit millimetres.
    JpegAndRaw,
    /// `bgr8` with rows that are padded, and depth as 32-bit metres, the greatest byte first.
    RawBigEndian,
    /// `rgb8`, and depth in PNG.
    RawAndPng,
}

/// Writes values one after another as CDR wants them.
struct Cdr(Vec<u8>);

impl Cdr {
    fn header(frame: &Frame, camera: &str) -> Self {
        let mut cdr = Self(vec![0, 1, 0, 0]);
        cdr.u32(frame.secs as u32);
        cdr.u32((1e9 * frame.secs.fract()) as u32);
        cdr.string(camera);
        cdr
    }

    fn align(&mut self, size: usize) {
        while !(self.0.len() - 4).is_multiple_of(size) {
            self.0.push(0);
        }
    }

    fn u32(&mut self, value: u32) {
        self.align(4);
        self.0.extend(value.to_le_bytes());
    }

    fn f64(&mut self, value: f64) {
        self.align(8);
        self.0.extend(value.to_le_bytes());
    }

    fn bytes(&mut self, bytes: &[u8]) {
        self.u32(bytes.len() as u32);
        self.0.extend(bytes);
    }

    fn string(&mut self, text: &str) {
        self.bytes(&[text.as_bytes(), &[0]].concat());
    }

    fn image(mut self, size: (usize, usize), encoding: &str, data: &[u8]) -> Vec<u8> {
        self.u32(size.1 as u32);
        self.u32(size.0 as u32);
        self.string(encoding);
        self.0.push(u8::from(encoding == "32FC1"));
        self.u32((data.len() / size.1) as u32);
        self.bytes(data);
        self.0
    }

    fn compressed(mut self, format: &str, data: &[u8]) -> Vec<u8> {
        self.string(format);
        self.bytes(data);
        self.0
    }
}

impl Walk {
    /// A bag with a colour camera, depth as it is measured and registered to colour, and an infrared
    /// camera.
    pub fn write_bag(&self, path: &Path, transport: Transport) {
        self.write_bag_of(path, transport, 0..self.frames.len());
    }

    /// The same of some frames, as a recorder splits long bags.
    pub fn write_bag_of(&self, path: &Path, transport: Transport, frames: Range<usize>) {
        self.write_topics(path, transport, frames, |_| true);
    }

    /// The same of some topics.
    pub fn write_topics(
        &self,
        path: &Path,
        transport: Transport,
        frames: Range<usize>,
        is_wanted: impl Fn(&str) -> bool,
    ) {
        let compression = match transport {
            Transport::JpegAndRaw => None,
            Transport::RawBigEndian => Some(Compression::Lz4),
            Transport::RawAndPng => Some(Compression::Zstd),
        };
        let options = WriteOptions::new()
            .profile("ros2")
            .compression(compression)
            .chunk_size(Some(200_000));
        let mut writer = options.create(File::create(path).unwrap()).unwrap();
        let mut wanted = HashSet::new();
        let mut topic = |name: &str, schema: &str| {
            let schema = format!("sensor_msgs/msg/{schema}");
            let schema = writer.add_schema(&schema, "ros2msg", b"").unwrap();
            let channel = writer.add_channel(schema, name, "cdr", &BTreeMap::new());
            let channel = channel.unwrap();
            if is_wanted(name) {
                wanted.insert(channel);
            }
            channel
        };
        let (color, depth) = match transport {
            Transport::JpegAndRaw => ("CompressedImage", "Image"),
            Transport::RawBigEndian => ("Image", "Image"),
            Transport::RawAndPng => ("Image", "CompressedImage"),
        };
        let suffix = |kind: &str, suffix: &str| match kind {
            "CompressedImage" => suffix.to_owned(),
            _ => String::new(),
        };
        let color_name = format!("/camera/color/image_raw{}", suffix(color, "/compressed"));
        let aligned = "/camera/aligned_depth_to_color/image_raw";
        let depth_name = format!("{aligned}{}", suffix(depth, "/compressedDepth"));
        let color_id = topic(&color_name, color);
        let depth_id = topic(&depth_name, depth);
        let info_id = topic("/camera/color/camera_info", "CameraInfo");
        let own_depth_id = topic("/camera/depth/image_rect_raw", "Image");
        let infrared_id = topic("/camera/infra1/image_rect_raw", "Image");
        let own_info_id = topic("/camera/depth/camera_info", "CameraInfo");
        for (index, frame) in self.frames.iter().enumerate() {
            if !frames.contains(&index) {
                continue;
            }
            // Written some time after it was taken, depth first.
            let log_time = (1e9 * frame.secs) as u64 + 7_000_000;
            let mut send = |channel_id: u16, delay: u64, data: &[u8]| {
                if !wanted.contains(&channel_id) {
                    return;
                }
                let header = MessageHeader {
                    channel_id,
                    sequence: index as u32,
                    log_time: log_time + delay,
                    publish_time: log_time + delay,
                };
                writer.write_to_known_channel(&header, data).unwrap();
            };
            let size = (self.camera.width, self.camera.height);
            let of_color = || Cdr::header(frame, "camera_color_optical_frame");
            let of_depth = || Cdr::header(frame, "camera_depth_optical_frame");
            let grey = vec![index as u8; size.0 * size.1];
            let turned: Vec<u8> = frame
                .depth_mm
                .data()
                .iter()
                .rev()
                .copied()
                .flat_map(u16::to_le_bytes)
                .collect();
            send(own_depth_id, 0, &of_depth().image(size, "16UC1", &turned));
            send(infrared_id, 0, &of_depth().image(size, "mono8", &grey));
            send(own_info_id, 0, &self.camera_info(of_depth(), 2.0));
            send(info_id, 0, &self.camera_info(of_color(), 1.0));
            match transport {
                Transport::JpegAndRaw => {
                    let mm = frame.depth_mm.data().iter().copied();
                    let mm: Vec<u8> = mm.flat_map(u16::to_le_bytes).collect();
                    send(depth_id, 0, &of_color().image(size, "16UC1", &mm));
                    let format = "rgb8; jpeg compressed bgr8";
                    send(
                        color_id,
                        400_000,
                        &of_color().compressed(format, &frame.jpeg),
                    );
                }
                Transport::RawBigEndian => {
                    let metres = frame.depth_mm.data().iter().map(|mm| match mm {
                        0 => f32::NAN,
                        mm => f32::from(*mm) / 1000.0,
                    });
                    let metres: Vec<u8> = metres.flat_map(f32::to_be_bytes).collect();
                    send(depth_id, 0, &of_color().image(size, "32FC1", &metres));
                    let rows = decoded(frame);
                    let rows = rows.data().chunks(size.0).flat_map(|row| {
                        let pixels = row.iter().flat_map(|[r, g, b]| [*b, *g, *r]);
                        pixels.chain([9; 5]).collect::<Vec<u8>>()
                    });
                    let bytes: Vec<u8> = rows.collect();
                    send(color_id, 400_000, &of_color().image(size, "bgr8", &bytes));
                }
                Transport::RawAndPng => {
                    let mut bytes = vec![0; 12];
                    bytes.extend(png(&frame.depth_mm));
                    let depth = of_color().compressed("16UC1; compressedDepth png", &bytes);
                    send(depth_id, 0, &depth);
                    let pixels = decoded(frame);
                    let bytes = pixels.data().as_flattened();
                    send(color_id, 400_000, &of_color().image(size, "rgb8", bytes));
                }
            }
        }
        writer.finish().unwrap();
    }

    fn camera_info(&self, mut cdr: Cdr, focal_factor: f64) -> Vec<u8> {
        let k = self.camera.intrinsics;
        let (fx, fy) = (focal_factor * k.fx, focal_factor * k.fy);
        cdr.u32(self.camera.height as u32);
        cdr.u32(self.camera.width as u32);
        cdr.string("plumb_bob");
        cdr.u32(5);
        let d = [0.0; 5];
        let matrix = [fx, 0.0, k.cx, 0.0, fy, k.cy, 0.0, 0.0, 1.0];
        let rotation = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        let projection = [0.0; 12];
        for value in d.iter().chain(&matrix).chain(&rotation).chain(&projection) {
            cdr.f64(*value);
        }
        for _ in 0..6 {
            cdr.u32(0);
        }
        cdr.0.push(0);
        cdr.0
    }
}

/// What a reader of the JPEG image sees.
fn decoded(frame: &Frame) -> Image<[u8; 3]> {
    let image = image::load_from_memory(&frame.jpeg).unwrap().into_rgb8();
    let size = (image.width() as usize, image.height() as usize);
    Image::new(size.0, size.1, image.into_raw().as_chunks().0.to_vec()).unwrap()
}
