//! A colour camera of ROS 2 with depth registered to it: what its messages say of it, and the images in
//! them. Bags and live topics have the same messages.

use std::path::Path;

use fgs_data::{CameraFile, DataError, FrameImages};
use fgs_geom::{Camera, Image, Intrinsics, PixelMap};

use crate::camera_file::camera_file;
use crate::cdr::{CdrReader, NotCdr};
use crate::fault::fault;
use crate::rational_lens::undistortion;
use crate::ros_messages::{CameraInfo, Header, RosImage};
use crate::working_image::WorkingImage;

/// Units a metre of depth in ROS.
const DEPTH_SCALE: f64 = 1000.0;

/// Names of topics with depth that was moved to the colour camera.
pub(crate) const REGISTERED: [&str; 4] = ["aligned", "registered", "to_color", "to_rgb"];

/// A topic with images, as its first message says.
pub struct ImageTopic {
    /// Its name.
    pub(crate) name: String,
    pub(crate) is_compressed: bool,
    pub(crate) is_depth: bool,
    pub(crate) is_grey: bool,
    pub(crate) frame: String,
    pub(crate) size: (usize, usize),
}

impl ImageTopic {
    /// What a message in CDR says of its topic: `sensor_msgs/msg/CompressedImage`, or else `Image`. `path` is
    /// where it comes from, for messages.
    ///
    /// # Errors
    /// If it is damaged, or its encoding is not understood.
    pub fn of(
        path: &Path,
        name: &str,
        is_compressed: bool,
        message: &[u8],
    ) -> Result<Self, DataError> {
        let image = read_image(message, is_compressed)
            .map_err(|NotCdr| fault(path, format!("an image of {name} is damaged")))?;
        let is_depth = image.is_depth().ok_or_else(|| {
            fault(
                path,
                format!("{name} has images of an encoding that is not understood"),
            )
        })?;
        Ok(Self {
            name: name.into(),
            is_compressed,
            is_depth,
            is_grey: image.is_grey(),
            frame: image.header.frame.clone(),
            size: image.size(path)?,
        })
    }

    /// Whether this is depth of the pixels of a colour topic.
    pub(crate) fn is_registered_to(&self, color: &Self) -> bool {
        self.is_of_camera(color) || REGISTERED.iter().any(|word| self.name.contains(word))
    }

    /// Whether both are images of one camera.
    pub(crate) fn is_of_camera(&self, color: &Self) -> bool {
        color.frame == self.frame && !color.frame.is_empty()
    }
}

/// Makes images of a camera's messages.
pub struct RosCamera {
    pub(crate) color: ImageTopic,
    pub(crate) depth: ImageTopic,
    file: CameraFile,
    working: WorkingImage,
    /// Of lenses that a camera file cannot describe.
    undistortion: Option<PixelMap>,
}

impl RosCamera {
    /// Of a message `sensor_msgs/msg/CameraInfo` in CDR, and two topics. `path` is where they come from, for
    /// messages.
    ///
    /// # Errors
    /// If they do not fit together, or the lens is not understood.
    pub fn open(
        path: &Path,
        info: &[u8],
        color: ImageTopic,
        depth: ImageTopic,
    ) -> Result<Self, DataError> {
        let info = CameraInfo::read(info).map_err(|NotCdr| {
            fault(
                path,
                format!("the camera_info of {} is damaged", color.name),
            )
        })?;
        if color.is_depth || !depth.is_depth {
            let message = format!("{} must have colour, and {} depth", color.name, depth.name);
            return Err(fault(path, message));
        }
        if !depth.is_registered_to(&color) {
            let message = format!(
                "{} in {:?} is not registered to {} in {:?}: depth is needed that the driver has aligned to \
                 colour",
                depth.name, depth.frame, color.name, color.frame
            );
            return Err(fault(path, message));
        }
        if (info.width, info.height) != color.size {
            let message = format!(
                "the camera_info is of {}x{} pixels, and {} of {}x{}",
                info.width, info.height, color.name, color.size.0, color.size.1
            );
            return Err(fault(path, message));
        }
        Self::new(path, &info, color, depth)
    }

    /// Of topics that fit together.
    pub(crate) fn new(
        path: &Path,
        info: &CameraInfo,
        color: ImageTopic,
        depth: ImageTopic,
    ) -> Result<Self, DataError> {
        let (native, bending) = lens(path, info, &color)?;
        let working =
            WorkingImage::new(&native, depth.size).map_err(|message| fault(path, message))?;
        let (distortion, undistortion) = match bending {
            Bending::Polynomial(distortion) => (distortion, None),
            Bending::Rational(d) => (None, Some(undistortion(&d, working.camera()))),
        };
        Ok(Self {
            color,
            depth,
            file: camera_file(*working.camera(), distortion, DEPTH_SCALE, path)?,
            working,
            undistortion,
        })
    }

    /// The camera of all its images.
    pub fn camera_file(&self) -> &CameraFile {
        &self.file
    }

    /// The frame, in ROS's sense, that colour was taken in: the camera's optical axes.
    pub fn frame_id(&self) -> &str {
        &self.color.frame
    }

    /// The images in two messages.
    ///
    /// # Errors
    /// If one is damaged, or not like the first of its topic.
    pub fn images(
        &self,
        path: &Path,
        color: &[u8],
        depth: &[u8],
    ) -> Result<FrameImages, DataError> {
        Ok(self.joined(&self.color(path, color)?, &self.depth_m(path, depth)?))
    }

    pub(crate) fn color(&self, path: &Path, message: &[u8]) -> Result<Image<[u8; 3]>, DataError> {
        let image = read_image(message, self.color.is_compressed);
        let image = image.map_err(|NotCdr| damaged(path, &self.color))?;
        image.color(path, self.working.color_size())
    }

    pub(crate) fn depth_m(&self, path: &Path, message: &[u8]) -> Result<Image<f32>, DataError> {
        let image = read_image(message, self.depth.is_compressed);
        let image = image.map_err(|NotCdr| damaged(path, &self.depth))?;
        image.depth_m(path, self.working.depth_size())
    }

    /// Both as images of the camera.
    pub(crate) fn joined(&self, color: &Image<[u8; 3]>, depth_m: &Image<f32>) -> FrameImages {
        let images = self.working.images(color, depth_m, None);
        let Some(map) = &self.undistortion else {
            return images;
        };
        FrameImages {
            // The map is made for this size.
            color: map.color(&images.color).unwrap_or(images.color),
            depth_m: map.depth(&images.depth_m).unwrap_or(images.depth_m),
            color_valid: Some(map.color_valid()),
        }
    }
}

/// When a message with a header was measured, seconds; `None` if it has none.
pub fn stamp_secs(message: &[u8]) -> Option<f64> {
    let mut reader = CdrReader::new(message).ok()?;
    Some(Header::read(&mut reader).ok()?.secs)
}

pub(crate) fn damaged(path: &Path, topic: &ImageTopic) -> DataError {
    fault(path, format!("an image of {} is damaged", topic.name))
}

fn read_image(message: &[u8], is_compressed: bool) -> Result<RosImage<'_>, NotCdr> {
    if is_compressed {
        RosImage::read_compressed(message)
    } else {
        RosImage::read(message)
    }
}

/// How a lens bends images.
enum Bending {
    /// As camera files have it; `None` if not at all.
    Polynomial(Option<[f64; 5]>),
    /// See [`undistortion`].
    Rational([f64; 8]),
}

/// The camera of a topic's images and its distortion.
fn lens(
    path: &Path,
    info: &CameraInfo,
    color: &ImageTopic,
) -> Result<(Camera, Bending), DataError> {
    let camera = |fx, fy, cx, cy| {
        let intrinsics = Intrinsics { fx, fy, cx, cy };
        Camera::new(color.size.0, color.size.1, intrinsics).map_err(|source| DataError::Camera {
            path: path.into(),
            source,
        })
    };
    if color.name.contains("rect") && info.p[0] > 0.0 {
        let [fx, _, cx, _, _, fy, cy, ..] = info.p;
        return Ok((camera(fx, fy, cx, cy)?, Bending::Polynomial(None)));
    }
    let [fx, _, cx, _, fy, cy, ..] = info.k;
    let camera = camera(fx, fy, cx, cy)?;
    if info.d.iter().all(|value| *value == 0.0) {
        return Ok((camera, Bending::Polynomial(None)));
    }
    let bending = match (info.distortion_model.as_str(), info.d.as_slice()) {
        ("plumb_bob", &[k1, k2, p1, p2]) => Bending::Polynomial(Some([k1, k2, p1, p2, 0.0])),
        ("plumb_bob", &[k1, k2, p1, p2, k3]) => Bending::Polynomial(Some([k1, k2, p1, p2, k3])),
        ("rational_polynomial", &[k1, k2, p1, p2, k3, k4, k5, k6]) => {
            Bending::Rational([k1, k2, p1, p2, k3, k4, k5, k6])
        }
        (model, d) => {
            return Err(fault(
                path,
                format!(
                    "the lens distortion {model:?} with {} coefficients is not understood: record \
                     rectified images",
                    d.len()
                ),
            ));
        }
    };
    Ok((camera, bending))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [u32; 2] = [64, 48];

    /// Writes a message: numbers at multiples of their size, counted from behind the first four bytes.
    struct Cdr(Vec<u8>);

    impl Cdr {
        fn new(frame: &str) -> Self {
            Self(vec![0, 1, 0, 0]).u32(7).u32(500_000_000).string(frame)
        }

        fn number<const N: usize>(mut self, bytes: [u8; N]) -> Self {
            self.0.resize(4 + (self.0.len() - 4).next_multiple_of(N), 0);
            self.0.extend(bytes);
            self
        }

        fn u32(self, value: u32) -> Self {
            self.number(value.to_le_bytes())
        }

        fn f64s(self, values: &[f64]) -> Self {
            let write = |cdr: Self, value: &f64| cdr.number(value.to_le_bytes());
            values.iter().fold(self, write)
        }

        fn bytes(self, bytes: &[u8]) -> Self {
            let mut cdr = self.u32(bytes.len() as u32);
            cdr.0.extend(bytes);
            cdr
        }

        fn string(self, text: &str) -> Self {
            self.bytes(&[text.as_bytes(), &[0]].concat())
        }
    }

    fn image(frame: &str, encoding: &str, [width, height]: [u32; 2], step: u32) -> Vec<u8> {
        let data = vec![100; (step * height) as usize];
        let cdr = Cdr::new(frame).u32(height).u32(width).string(encoding);
        cdr.number([0]).u32(step).bytes(&data).0
    }

    fn info([width, height]: [u32; 2]) -> Vec<u8> {
        let cdr = Cdr::new("lens").u32(height).u32(width).string("plumb_bob");
        let k = [60.0, 0.0, 31.5, 0.0, 60.0, 23.5, 0.0, 0.0, 1.0];
        cdr.u32(5).f64s(&[0.0; 5]).f64s(&k).f64s(&[0.0; 21]).0
    }

    fn color() -> Vec<u8> {
        image("lens", "rgb8", SIZE, 3 * SIZE[0])
    }

    fn depth() -> Vec<u8> {
        image("lens", "16UC1", SIZE, 2 * SIZE[0])
    }

    fn open(info: &[u8], color: &[u8], depth: &[u8]) -> Result<RosCamera, String> {
        let path = Path::new("ROS 2");
        let topic = |name: &str, message: &[u8]| ImageTopic::of(path, name, false, message);
        topic("/color", color)
            .and_then(|color| RosCamera::open(path, info, color, topic("/depth", depth)?))
            .map_err(|error| error.to_string())
    }

    #[test]
    fn messages_become_images() {
        let camera = open(&info(SIZE), &color(), &depth()).unwrap();
        assert_eq!(camera.camera_file().camera().intrinsics.fx, 60.0);
        assert_eq!(stamp_secs(&color()), Some(7.5));
        let images = camera.images(Path::new("ROS 2"), &color(), &depth());
        let images = images.unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(images.color.at(63, 47), [100; 3]);
        assert!((images.depth_m.at(63, 47) - 0.001 * f32::from(0x6464_u16)).abs() < 1e-6);
    }

    #[test]
    fn what_does_not_fit_together_is_refused() {
        let elsewhere = image("other", "16UC1", SIZE, 2 * SIZE[0]);
        for (message, expected) in [
            (open(&info([32, 24]), &color(), &depth()), "32x24 pixels"),
            (open(&info(SIZE), &depth(), &color()), "must have colour"),
            (open(&info(SIZE), &color(), &elsewhere), "not registered"),
            (open(&[0, 1], &color(), &depth()), "damaged"),
            (
                open(&info(SIZE), &image("lens", "yuv422", SIZE, 128), &depth()),
                "not understood",
            ),
        ] {
            let message = message.err().unwrap();
            assert!(message.contains(expected), "{message}");
        }
        let camera = open(&info(SIZE), &color(), &depth()).unwrap();
        let small = image("lens", "rgb8", [32, 24], 96);
        let error = camera.images(Path::new("ROS 2"), &small, &depth()).err();
        assert!(error.unwrap().to_string().contains("32x24"));
    }

    /// Each message cut off anywhere, and with each byte of its head changed.
    #[test]
    fn no_message_is_too_damaged() {
        let messages = [info(SIZE), color(), depth()];
        let camera = open(&messages[0], &messages[1], &messages[2]).unwrap();
        for damaged in 0..3 {
            let whole = &messages[damaged];
            for at in 0..200 {
                let mut changed = whole.clone();
                changed[at] ^= 0xff;
                for message in [whole[..at].to_vec(), changed] {
                    let mut messages = messages.clone();
                    messages[damaged] = message;
                    let [info, color, depth] = &messages;
                    let _ = open(info, color, depth);
                    let _ = camera.images(Path::new("ROS 2"), color, depth);
                    let _ = stamp_secs(&messages[damaged]);
                }
            }
        }
    }
}
