//! The messages of ROS 2 that are published, field by field as ROS defines them.

use fgs_geom::Se3;
use serde::{Deserialize, Serialize};

/// `builtin_interfaces/msg/Time`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Stamp {
    /// Whole seconds.
    pub sec: i32,
    /// The rest, nanoseconds.
    pub nanosec: u32,
}

impl Stamp {
    /// The nearest to a time in seconds.
    pub fn of(secs: f64) -> Self {
        let nanoseconds = (secs * 1e9).round() as i64;
        Self {
            sec: i32::try_from(nanoseconds.div_euclid(1_000_000_000)).unwrap_or(i32::MAX),
            nanosec: nanoseconds.rem_euclid(1_000_000_000) as u32,
        }
    }

    /// Seconds.
    pub fn secs(self) -> f64 {
        f64::from(self.sec) + f64::from(self.nanosec) / 1e9
    }
}

/// `std_msgs/msg/Header`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// When.
    pub stamp: Stamp,
    /// In which axes.
    pub frame_id: String,
}

/// `geometry_msgs/msg/Vector3` and `Point`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Xyz {
    pub x: f64,
    pub y: f64,
    pub z: f64,
}

/// `geometry_msgs/msg/Quaternion`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Xyzw {
    pub x: f64,
    pub y: f64,
    pub z: f64,
    pub w: f64,
}

/// `geometry_msgs/msg/Pose` and `Transform`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Metres.
    pub position: Xyz,
    /// A unit quaternion.
    pub orientation: Xyzw,
}

impl From<&Se3> for Pose {
    fn from(pose: &Se3) -> Self {
        let (t, q) = (&pose.translation, &pose.rotation);
        Self {
            position: Xyz {
                x: t.x,
                y: t.y,
                z: t.z,
            },
            orientation: Xyzw {
                x: q.i,
                y: q.j,
                z: q.k,
                w: q.w,
            },
        }
    }
}

/// `geometry_msgs/msg/PoseStamped`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseStamped {
    /// When, and in which axes.
    pub header: Header,
    /// Of the camera.
    pub pose: Pose,
}

/// `nav_msgs/msg/Path`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Path {
    /// When it was known like this.
    pub header: Header,
    /// From the oldest on.
    pub poses: Vec<PoseStamped>,
}

/// `geometry_msgs/msg/TransformStamped`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TransformStamped {
    /// When, and the parent's axes.
    pub header: Header,
    /// The child's axes.
    pub child_frame_id: String,
    /// Brings the child's coordinates to the parent's.
    pub transform: Pose,
}

/// `tf2_msgs/msg/TFMessage`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TfMessage {
    /// Transforms.
    pub transforms: Vec<TransformStamped>,
}

/// `sensor_msgs/msg/PointField`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PointField {
    /// What it is.
    pub name: String,
    /// Bytes from the point's begin.
    pub offset: u32,
    /// 7 is a 32-bit float.
    pub datatype: u8,
    /// How many of them.
    pub count: u32,
}

/// `sensor_msgs/msg/PointCloud2`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[expect(missing_docs, reason = "they are what ROS says they are")]
pub struct PointCloud2 {
    pub header: Header,
    pub height: u32,
    pub width: u32,
    pub fields: Vec<PointField>,
    pub is_bigendian: bool,
    pub point_step: u32,
    pub row_step: u32,
    pub data: Vec<u8>,
    pub is_dense: bool,
}

/// `std_msgs/msg/MultiArrayDimension`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MultiArrayDimension {
    /// What it counts.
    pub label: String,
    /// How many.
    pub size: u32,
    /// Elements in it.
    pub stride: u32,
}

/// `std_msgs/msg/UInt8MultiArray`, its layout's fields first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UInt8MultiArray {
    /// What the bytes are.
    pub dim: Vec<MultiArrayDimension>,
    /// Bytes before the first.
    pub data_offset: u32,
    /// The bytes.
    pub data: Vec<u8>,
}

/// `sensor_msgs/msg/Image`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[expect(missing_docs, reason = "they are what ROS says they are")]
pub struct Image {
    pub header: Header,
    pub height: u32,
    pub width: u32,
    pub encoding: String,
    pub is_bigendian: u8,
    pub step: u32,
    pub data: Vec<u8>,
}

/// `sensor_msgs/msg/RegionOfInterest`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[expect(missing_docs, reason = "they are what ROS says they are")]
pub struct RegionOfInterest {
    pub x_offset: u32,
    pub y_offset: u32,
    pub height: u32,
    pub width: u32,
    pub do_rectify: bool,
}

/// `sensor_msgs/msg/CameraInfo`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[expect(missing_docs, reason = "they are what ROS says they are")]
pub struct CameraInfo {
    pub header: Header,
    pub height: u32,
    pub width: u32,
    pub distortion_model: String,
    pub d: Vec<f64>,
    pub k: [f64; 9],
    pub r: [f64; 9],
    pub p: [f64; 12],
    pub binning_x: u32,
    pub binning_y: u32,
    pub roi: RegionOfInterest,
}
