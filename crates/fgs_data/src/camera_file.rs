//! Camera files: `camera.toml`, the `[camera]` table of a configuration, or Replica's
//! `cam_params.json`.
//!
//! A [`CameraFile`] is validated on construction, whatever its source, so the rest of the code can
//! rely on it.

use std::ops::Range;
use std::path::Path;

use fgs_geom::{Camera, CameraError, DepthSensor, Distortion, Intrinsics, Se3};
use serde::{Deserialize, Serialize};

use crate::{DataError, SensorTimes, plain_words};

/// A camera file is seven numbers; this leaves room for comments.
const MAX_FILE_BYTES: u64 = 64 * 1024;

/// A hundred megapixels: more than any RGB-D sensor has, and few enough that a damaged file cannot
/// exhaust the memory.
const MAX_PIXELS: usize = 100_000_000;

/// Camera intrinsics, lens distortion and the unit of the depth images.
///
/// Keys: `width`, `height` (pixels), `fx`, `fy`, `cx`, `cy` (pixels, pixel centres at integer
/// coordinates), `depth_scale` (raw depth value of 1 m) and, for distorted images,
/// `distortion = [k1, k2, p1, p2, k3]`; where depth is not where colour is,
/// `color_from_depth = [tx, ty, tz, qx, qy, qz, qw]` (metres); and `depth_delay_secs`,
/// `color_readout_secs` and `depth_readout_secs`, see [`SensorTimes`]. Unknown keys are rejected.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(try_from = "Keys", into = "Keys")]
pub struct CameraFile {
    camera: Camera,
    distortion: Option<Distortion>,
    depth_scale: f64,
    color_from_depth: Se3,
    sensor_times: SensorTimes,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Keys {
    width: usize,
    height: usize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    depth_scale: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    distortion: Option<[f64; 5]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    color_from_depth: Option<[f64; 7]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    depth_delay_secs: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    color_readout_secs: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    depth_readout_secs: Option<f64>,
}

/// A configuration file, as far as it is about the camera.
#[derive(Deserialize)]
struct Configuration {
    camera: Keys,
}

/// Replica's `cam_params.json` as NICE-SLAM lays it out.
#[derive(Deserialize)]
struct ReplicaFile {
    camera: ReplicaKeys,
}

#[derive(Deserialize)]
struct ReplicaKeys {
    w: usize,
    h: usize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    scale: f64,
}

impl CameraFile {
    /// Validates the parameters: those of [`Camera::new`], at most 100 megapixels, a depth scale
    /// from 1 to 1e6 per metre, distortion coefficients (k1, k2, p1, p2, k3) from -10 to 10.
    ///
    /// # Errors
    /// Names the first parameter out of range.
    pub fn new(
        camera: Camera,
        distortion: Option<[f64; 5]>,
        depth_scale: f64,
    ) -> Result<Self, CameraError> {
        let camera = Camera::new(camera.width, camera.height, camera.intrinsics)?;
        if camera.width * camera.height > MAX_PIXELS {
            return refuse("height", camera.height as f64, "at most 100 megapixels");
        }
        if !(1.0..=1e6).contains(&depth_scale) {
            return refuse("depth_scale", depth_scale, "1 to 1000000 (values a metre)");
        }
        for &value in distortion.iter().flatten() {
            if !(-10.0..=10.0).contains(&value) {
                return refuse("distortion", value, "coefficients from -10 to 10");
            }
        }
        Ok(Self {
            camera,
            distortion: distortion.map(Distortion::from_array),
            depth_scale,
            color_from_depth: Se3::identity(),
            sensor_times: SensorTimes::default(),
        })
    }

    /// The same camera with its depth sensor up to 1 m away.
    ///
    /// # Errors
    /// If it is farther away.
    pub fn with_color_from_depth(mut self, color_from_depth: Se3) -> Result<Self, CameraError> {
        let shift_m = color_from_depth.translation.norm();
        if !(0.0..=1.0).contains(&shift_m) {
            return refuse("color_from_depth", shift_m, "a shift of up to 1 m");
        }
        self.color_from_depth = color_from_depth;
        Ok(self)
    }

    /// The same camera with other times: a delay of up to 1 s, readouts of up to 0.2 s.
    ///
    /// # Errors
    /// If a value is out of range.
    pub fn with_sensor_times(mut self, times: SensorTimes) -> Result<Self, CameraError> {
        times.check()?;
        self.sensor_times = times;
        Ok(self)
    }

    /// Reads a camera file such as `camera.toml`; see [`CameraFile::parse`].
    ///
    /// # Errors
    /// If the file cannot be read, or [`CameraFile::parse`] rejects its contents.
    pub fn read(path: &Path) -> Result<Self, DataError> {
        Self::parse(&read_small_file(path)?, path)
    }

    /// Parses the text of a camera file: the keys alone, or a settings file that has them in a
    /// `[camera]` table, whose other tables are ignored. `path` is only used in error messages.
    ///
    /// # Errors
    /// For invalid TOML and for missing, unknown or implausible values, with path and key.
    pub fn parse(text: &str, path: &Path) -> Result<Self, DataError> {
        let parse = || {
            if toml::from_str::<toml::Table>(text)?.contains_key("camera") {
                toml::from_str::<Configuration>(text).map(|file| file.camera)
            } else {
                toml::from_str(text)
            }
        };
        let keys: Keys = parse().map_err(|error| DataError::CameraFile {
            path: path.into(),
            line: error.span().and_then(|span| line_of(text, span)),
            message: plain_words(&error.message().replace('\n', " ")),
        })?;
        keys.checked(path)
    }

    /// Reads Replica's `cam_params.json`: `{"camera": {"w", "h", "fx", "fy", "cx", "cy",
    /// "scale"}}`.
    pub(crate) fn read_replica(path: &Path) -> Result<Self, DataError> {
        let file: ReplicaFile = serde_json::from_str(&read_small_file(path)?).map_err(|error| {
            DataError::CameraFile {
                path: path.into(),
                line: None, // the message has it
                message: plain_words(&error.to_string()),
            }
        })?;
        let ReplicaKeys {
            w,
            h,
            fx,
            fy,
            cx,
            cy,
            scale,
        } = file.camera;
        Keys {
            width: w,
            height: h,
            fx,
            fy,
            cx,
            cy,
            depth_scale: scale,
            distortion: None,
            color_from_depth: None,
            depth_delay_secs: None,
            color_readout_secs: None,
            depth_readout_secs: None,
        }
        .checked(path)
    }

    /// The pinhole camera.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The lens distortion; `None` if the images are undistorted.
    pub fn distortion(&self) -> Option<&Distortion> {
        self.distortion.as_ref()
    }

    /// The raw depth value of 1 m.
    pub fn depth_scale(&self) -> f64 {
        self.depth_scale
    }

    /// Where and when depth is measured, as seen from the colour camera. Times that are not known are 0.
    pub fn depth_sensor(&self) -> DepthSensor {
        DepthSensor {
            delay_secs: self.sensor_times.depth_delay_secs.unwrap_or(0.0),
            color_from_depth: self.color_from_depth,
            readout_secs: self.sensor_times.depth_readout_secs.unwrap_or(0.0),
        }
    }

    /// How long the colour camera takes to read its rows, seconds; 0 for a global shutter, and if it is
    /// not known.
    pub fn color_readout_secs(&self) -> f64 {
        self.sensor_times.color_readout_secs.unwrap_or(0.0)
    }

    /// When images are taken, as far as it is known.
    pub fn sensor_times(&self) -> SensorTimes {
        self.sensor_times
    }
}

impl Keys {
    fn checked(self, path: &Path) -> Result<CameraFile, DataError> {
        CameraFile::try_from(self).map_err(|source| DataError::Camera {
            path: path.into(),
            source,
        })
    }
}

impl TryFrom<Keys> for CameraFile {
    type Error = CameraError;

    fn try_from(keys: Keys) -> Result<Self, CameraError> {
        let camera = Camera {
            width: keys.width,
            height: keys.height,
            intrinsics: Intrinsics {
                fx: keys.fx,
                fy: keys.fy,
                cx: keys.cx,
                cy: keys.cy,
            },
        };
        let color_from_depth = match keys.color_from_depth {
            None => Se3::identity(),
            Some([tx, ty, tz, qx, qy, qz, qw]) => Se3::from_wxyz([qw, qx, qy, qz], [tx, ty, tz])
                .ok_or(CameraError {
                    key: "color_from_depth",
                    value: qw,
                    expected: "tx, ty, tz, qx, qy, qz, qw, a quaternion of length 1".into(),
                })?,
        };
        Self::new(camera, keys.distortion, keys.depth_scale)?
            .with_color_from_depth(color_from_depth)?
            .with_sensor_times(SensorTimes {
                depth_delay_secs: keys.depth_delay_secs,
                color_readout_secs: keys.color_readout_secs,
                depth_readout_secs: keys.depth_readout_secs,
            })
    }
}

impl From<CameraFile> for Keys {
    fn from(file: CameraFile) -> Self {
        let Intrinsics { fx, fy, cx, cy } = file.camera.intrinsics;
        let (pose, times) = (file.color_from_depth, file.sensor_times);
        Self {
            width: file.camera.width,
            height: file.camera.height,
            fx,
            fy,
            cx,
            cy,
            depth_scale: file.depth_scale,
            distortion: file.distortion.map(|d| [d.k1, d.k2, d.p1, d.p2, d.k3]),
            color_from_depth: (pose != Se3::identity()).then(|| {
                let (t, q) = (pose.translation, pose.rotation.quaternion());
                [t.x, t.y, t.z, q.i, q.j, q.k, q.w]
            }),
            depth_delay_secs: times.depth_delay_secs,
            color_readout_secs: times.color_readout_secs,
            depth_readout_secs: times.depth_readout_secs,
        }
    }
}

pub(crate) fn refuse<T>(key: &'static str, value: f64, expected: &str) -> Result<T, CameraError> {
    Err(CameraError {
        key,
        value,
        expected: expected.into(),
    })
}

/// The line, from 1, that a span of bytes begins on; `None` for the empty span of what is missing.
fn line_of(text: &str, span: Range<usize>) -> Option<usize> {
    let before = text.get(..span.start)?;
    (!span.is_empty()).then(|| before.matches('\n').count() + 1)
}

fn read_small_file(path: &Path) -> Result<String, DataError> {
    fgs_files::read_text(path, MAX_FILE_BYTES).map_err(|source| DataError::Io {
        path: path.into(),
        source,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "width = 640\nheight = 480\nfx = 517.3\nfy = 516.5\ncx = 318.6\ncy = 255.3\n\
                        depth_scale = 5000.0\ndistortion = [0.2624, -0.9531, -0.0054, 0.0026, 1.1633]\n";

    fn refusal(text: &str) -> String {
        CameraFile::parse(text, Path::new("dir/camera.toml"))
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn what_is_written_is_read() {
        let file = CameraFile::parse(GOOD, Path::new("camera.toml")).unwrap();
        assert_eq!((file.camera().width, file.camera().height), (640, 480));
        assert_eq!(file.camera().intrinsics.cy, 255.3);
        assert_eq!(file.depth_scale(), 5000.0);
        assert_eq!(file.distortion().unwrap().k3, 1.1633);
        let text = toml::to_string(&file).unwrap();
        assert_eq!(toml::from_str::<CameraFile>(&text).unwrap(), file);
        assert_eq!(file.depth_sensor(), DepthSensor::default());
        assert_eq!(file.sensor_times(), SensorTimes::default());
    }

    #[test]
    fn a_depth_sensor_is_read_and_written() {
        let text = format!(
            "{GOOD}depth_delay_secs = -0.012\ncolor_from_depth = [0.01, 0.0, 0.0, 0.0, 0.6, 0.0, 0.8]\n\
             depth_readout_secs = 0.031\ncolor_readout_secs = 0.027\n"
        );
        let file = CameraFile::parse(&text, Path::new("camera.toml")).unwrap();
        let sensor = file.depth_sensor();
        assert_eq!((sensor.delay_secs, sensor.readout_secs), (-0.012, 0.031));
        assert_eq!(file.color_readout_secs(), 0.027);
        assert_eq!(sensor.color_from_depth.translation.x, 0.01);
        assert!((sensor.color_from_depth.rotation.j - 0.6).abs() <= 1e-15);
        let written = toml::to_string(&file).unwrap();
        let read = toml::from_str::<CameraFile>(&written).unwrap();
        assert_eq!(read, file);
        // That there is no delay may be known too.
        let prompt = text.replace("-0.012", "0.0");
        let prompt = CameraFile::parse(&prompt, Path::new("camera.toml")).unwrap();
        assert_eq!(prompt.sensor_times().depth_delay_secs, Some(0.0));
        let written = toml::to_string(&prompt).unwrap();
        assert_eq!(toml::from_str::<CameraFile>(&written).unwrap(), prompt);
        for (from, to, key) in [
            ("-0.012", "nan", "depth_delay_secs"),
            ("-0.012", "-1.5", "depth_delay_secs"),
            ("[0.01", "[5.0", "color_from_depth"),
            ("0.031", "31.0", "depth_readout_secs"),
            ("0.027", "nan", "color_readout_secs"),
            ("0.6, 0.0, 0.8", "0.0, 0.0, 0.0", "color_from_depth"),
        ] {
            let refused = refusal(&text.replace(from, to));
            assert!(refused.contains(key), "{refused}");
        }
    }

    #[test]
    fn a_configuration_with_a_camera_table_is_a_camera_file_too() {
        let path = Path::new("c.toml");
        let text = format!("seed = 5\n\n[mapping]\nprune_every = 3\n\n[camera]\n{GOOD}");
        let expected = CameraFile::parse(GOOD, path).unwrap();
        assert_eq!(CameraFile::parse(&text, path).unwrap(), expected);
        let refused = refusal(&text.replace("fy =", "focal ="));
        assert!(
            refused.starts_with("dir/camera.toml:10: unknown field `focal`"),
            "{refused}"
        );
        let no_camera = refusal("seed = 5\n");
        assert!(no_camera.contains("unknown field `seed`"), "{no_camera}");
    }

    #[test]
    fn refusals_name_file_and_key() {
        assert_eq!(
            refusal(&GOOD.replace("fx = 517.3\n", "")),
            "dir/camera.toml: missing field `fx`"
        );
        let unknown = refusal(&GOOD.replace("fy =", "focal ="));
        assert!(
            unknown.starts_with("dir/camera.toml:4: unknown field `focal`"),
            "{unknown}"
        );
        assert_eq!(
            refusal(&GOOD.replace("517.3", "nan")),
            "dir/camera.toml: fx = NaN is not possible: 64 to 64000 pixels"
        );
        assert_eq!(
            refusal(&GOOD.replace("5000.0", "0")),
            "dir/camera.toml: depth_scale = 0 is not possible: 1 to 1000000 (values a metre)"
        );
        assert!(refusal(&GOOD.replace("0.2624", "inf")).contains("distortion = inf"));
        let huge = GOOD
            .replace("640", "60000")
            .replace("480", "60000")
            .replace("51", "10051");
        assert!(
            refusal(&huge).contains("100 megapixels"),
            "{}",
            refusal(&huge)
        );
        let text = refusal(&GOOD.replace("517.3", "'wide'"));
        assert!(text.starts_with("dir/camera.toml:3:"), "{text}");
        let short = refusal(&GOOD.replace(", 1.1633", ""));
        assert!(short.starts_with("dir/camera.toml:8:"), "{short}");
        assert_eq!(refusal("").lines().count(), 1);
    }
}
