//! The stream of a camera: 640x480 pixels, 30 a second, depth aligned to colour by librealsense.

use std::collections::HashSet;
use std::ffi::CString;
use std::path::Path;
use std::time::Duration;

use fgs_data::{CameraFile, DataError, FrameImages, LiveImages};
use fgs_geom::{Camera, CameraError, Image, Intrinsics};
use realsense_rust::base::Rs2Intrinsics;
use realsense_rust::config::Config;
use realsense_rust::context::Context;
use realsense_rust::frame::{ColorFrame, CompositeFrame, DepthFrame, FrameEx, PixelKind};
use realsense_rust::kind::{Rs2DistortionModel, Rs2Format, Rs2StreamKind};
use realsense_rust::pipeline::{ActivePipeline, InactivePipeline};
use realsense_rust::processing_blocks::align::Align;

use crate::camera::RealsenseError;

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
const FRAMES_PER_SECOND: usize = 30;

/// After so long without an image the camera is gone.
const SILENCE: Duration = Duration::from_secs(5);

/// Values a metre, should depth be written down as whole numbers: a RealSense camera's own.
const DEPTH_SCALE: f64 = 1000.0;

/// A camera at work.
pub(crate) struct Stream {
    pipeline: ActivePipeline,
    align: Align,
    file: CameraFile,
}

impl Stream {
    /// Starts the camera with a serial number, or the first.
    ///
    /// # Errors
    /// If there is none, or it has no such streams.
    pub fn start(serial: Option<String>) -> Result<Self, RealsenseError> {
        let context = Context::new().map_err(RealsenseError::sdk)?;
        if context.query_devices(HashSet::new()).is_empty() {
            return Err(RealsenseError::NoCamera { serial });
        }
        let mut config = Config::new();
        for (stream, format) in [
            (Rs2StreamKind::Color, Rs2Format::Rgb8),
            (Rs2StreamKind::Depth, Rs2Format::Z16),
        ] {
            config
                .enable_stream(stream, None, WIDTH, HEIGHT, format, FRAMES_PER_SECOND)
                .map_err(RealsenseError::sdk)?;
        }
        let pipeline = InactivePipeline::try_from(&context).map_err(RealsenseError::sdk)?;
        if let Some(serial) = serial {
            let number = CString::new(serial.as_str()).map_err(RealsenseError::sdk)?;
            let config = config.enable_device_from_serial(&number);
            if !pipeline.can_resolve(config.map_err(RealsenseError::sdk)?) {
                let serial = Some(serial);
                return Err(RealsenseError::NoCamera { serial });
            }
        }
        let pipeline = pipeline.start(Some(config)).map_err(RealsenseError::sdk)?;
        let streams = pipeline.profile().streams();
        let color = streams
            .iter()
            .find(|stream| stream.kind() == Rs2StreamKind::Color);
        let color = color.ok_or_else(|| RealsenseError::sdk("it has no colour stream"))?;
        let file = camera_file(&color.intrinsics().map_err(RealsenseError::sdk)?)?;
        Ok(Self {
            pipeline,
            align: Align::new(Rs2StreamKind::Color, 1).map_err(RealsenseError::sdk)?,
            file,
        })
    }

    /// The colour camera.
    pub fn camera_file(&self) -> &CameraFile {
        &self.file
    }

    /// Waits for the next images; `None` once none come any more.
    pub fn next(&mut self) -> Option<Result<LiveImages, DataError>> {
        let frames = self.pipeline.wait(Some(SILENCE)).ok()?;
        Some(self.images(frames))
    }

    fn images(&mut self, frames: CompositeFrame) -> Result<LiveImages, DataError> {
        let measured: Vec<DepthFrame> = frames.frames_of_type();
        let measured = measured.first().ok_or_else(|| fault("no depth came"))?;
        let m_per_unit = measured.depth_units().map_err(fault)?;
        self.align.queue(frames).map_err(fault)?;
        let aligned = self.align.wait(SILENCE).map_err(fault)?;
        let (colors, depths): (Vec<ColorFrame>, Vec<DepthFrame>) =
            (aligned.frames_of_type(), aligned.frames_of_type());
        let (Some(color), Some(depth)) = (colors.first(), depths.first()) else {
            return Err(fault("colour or depth is missing"));
        };
        let images = FrameImages {
            color: Image::from_fn(color.width(), color.height(), |u, v| {
                match color.get(u, v) {
                    Some(PixelKind::Rgb8 { r, g, b }) => [*r, *g, *b],
                    _ => [0; 3],
                }
            }),
            depth_m: Image::from_fn(depth.width(), depth.height(), |u, v| {
                match depth.get(u, v) {
                    Some(PixelKind::Z16 { depth }) => m_per_unit * f32::from(*depth),
                    _ => 0.0,
                }
            }),
            color_valid: None,
        };
        Ok(LiveImages {
            // Milliseconds.
            timestamp_secs: color.timestamp() / 1e3,
            images,
        })
    }
}

fn fault(error: impl std::fmt::Display) -> DataError {
    DataError::Recording {
        path: "realsense".into(),
        message: error.to_string(),
    }
}

/// The colour camera as librealsense knows it. Both plain models of Brown and Conrady are taken as that of
/// camera files, as its own projection takes them when it aligns depth.
fn camera_file(k: &Rs2Intrinsics) -> Result<CameraFile, DataError> {
    let intrinsics = Intrinsics {
        fx: k.fx().into(),
        fy: k.fy().into(),
        cx: k.ppx().into(),
        cy: k.ppy().into(),
    };
    let refusal = |source: CameraError| DataError::Camera {
        path: Path::new("realsense").into(),
        source,
    };
    let camera = Camera::new(k.width(), k.height(), intrinsics).map_err(refusal)?;
    let lens = k.distortion();
    let distortion = match lens.model {
        _ if lens.coeffs.iter().all(|value| *value == 0.0) => None,
        Rs2DistortionModel::None => None,
        Rs2DistortionModel::BrownConrady | Rs2DistortionModel::BrownConradyInverse => {
            Some(lens.coeffs.map(f64::from))
        }
        model => {
            return Err(fault(format!(
                "the lens distortion {model:?} is not understood"
            )));
        }
    };
    CameraFile::new(camera, distortion, DEPTH_SCALE).map_err(refusal)
}
