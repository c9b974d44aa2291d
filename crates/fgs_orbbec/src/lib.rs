//! Orbbec cameras, through OrbbecSDK 2: colour, and depth that it aligns to colour.
//!
//! It was compiled and linked with OrbbecSDK 2.9 and run up to the point where no camera is found. It was
//! never run with a camera.

#![cfg(feature = "sdk")]

use std::fmt::Display;

use fgs_data::{CameraFile, CameraSource, DataError, FrameImages, LiveImages};
use fgs_geom::{Camera, Image, Intrinsics, depth_from_raw};
use orbbec::{
    AlignFilter, CameraParam, ColorFrame, Config, DepthFrame, Error, FrameType, Frameset, Pipeline,
    StreamType,
};
use thiserror::Error;

const WIDTH: u32 = 640;
const HEIGHT: u32 = 480;
const FRAMES_PER_SECOND: u32 = 30;

/// `OB_FORMAT_RGB`.
const RGB: i32 = 22;
/// `OB_FORMAT_Y16`.
const Y16: i32 = 8;
/// `OB_WIDTH_ANY` and `OB_HEIGHT_ANY`.
const ANY: u32 = 0;

/// After so long without an image, milliseconds, the camera is gone.
const SILENCE_MS: u32 = 5000;

/// Values a metre, of cameras as they are delivered.
const DEPTH_SCALE: f32 = 1000.0;

/// Why a camera cannot be used.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum OrbbecError {
    /// OrbbecSDK refused something; mostly because no camera is plugged in.
    #[error("no Orbbec camera can be started: {0}")]
    Sdk(#[from] Error),
    /// No images came.
    #[error("the Orbbec camera gives no images")]
    Silent,
    /// Its lens is not understood, or out of range.
    #[error(transparent)]
    Lens(#[from] DataError),
}

/// Images of an Orbbec camera.
pub struct OrbbecCamera {
    pipeline: Pipeline,
    align: AlignFilter,
    file: CameraFile,
}

/// Starts the first camera.
///
/// # Errors
/// If there is none, or it cannot be started.
pub fn open() -> Result<OrbbecCamera, OrbbecError> {
    let mut pipeline = Pipeline::new()?;
    let mut config = Config::new()?;
    config.enable_video_stream(StreamType::Color, WIDTH, HEIGHT, FRAMES_PER_SECOND, RGB)?;
    config.enable_video_stream(StreamType::Depth, ANY, ANY, FRAMES_PER_SECOND, Y16)?;
    pipeline.enable_frame_sync()?;
    pipeline.start_with_config(&config)?;
    let align = AlignFilter::new()?;
    while !align.set_align_target(&next_frames(&mut pipeline)?, StreamType::Color)? {}
    Ok(OrbbecCamera {
        file: camera_file(&pipeline.camera_param()?)?,
        pipeline,
        align,
    })
}

fn next_frames(pipeline: &mut Pipeline) -> Result<Frameset, OrbbecError> {
    pipeline
        .wait_for_frameset(SILENCE_MS)?
        .ok_or(OrbbecError::Silent)
}

impl CameraSource for OrbbecCamera {
    fn camera_file(&self) -> &CameraFile {
        &self.file
    }

    /// Ends when the camera is unplugged.
    fn next_images(&mut self) -> Option<Result<LiveImages, DataError>> {
        loop {
            let frames = next_frames(&mut self.pipeline).ok()?;
            // While it starts, one of both may be missing.
            if [FrameType::Color, FrameType::Depth]
                .into_iter()
                .all(|kind| frames.frame(kind).is_some())
            {
                return Some(self.images(&frames));
            }
        }
    }
}

impl OrbbecCamera {
    fn images(&self, frames: &Frameset) -> Result<LiveImages, DataError> {
        let aligned = self.align.process(frames).map_err(fault)?;
        let aligned = aligned.ok_or_else(|| fault("depth is not aligned"))?;
        let aligned = Frameset::from_frame(aligned);
        let color = aligned.frame(FrameType::Color);
        let color = color.ok_or_else(|| fault("no colour came"))?;
        let timestamp_secs = color.timestamp_us() as f64 / 1e6;
        let color = ColorFrame::try_new(color).filter(|color| color.format() == RGB);
        let color = color.ok_or_else(|| fault("colour is not RGB"))?;
        let depth = aligned
            .frame(FrameType::Depth)
            .and_then(DepthFrame::try_new);
        let depth = depth.ok_or_else(|| fault("depth is no image of 16 bits"))?;
        let pixels = color.data().as_chunks().0.to_vec();
        let color = Image::new(color.width() as usize, color.height() as usize, pixels);
        let size = (depth.width() as usize, depth.height() as usize);
        let raw = Image::new(size.0, size.1, depth.pixels()).map_err(fault)?;
        Ok(LiveImages {
            timestamp_secs,
            images: FrameImages {
                color: color.map_err(fault)?,
                depth_m: depth_from_raw(&raw, DEPTH_SCALE, 0),
                color_valid: None,
            },
        })
    }
}

fn fault(error: impl Display) -> DataError {
    DataError::Recording {
        path: "orbbec".into(),
        message: error.to_string(),
    }
}

/// The colour camera as OrbbecSDK knows it.
fn camera_file(known: &CameraParam) -> Result<CameraFile, DataError> {
    let (k, lens) = (known.rgb, known.rgb_distortion);
    let intrinsics = Intrinsics {
        fx: k.fx.into(),
        fy: k.fy.into(),
        cx: k.cx.into(),
        cy: k.cy.into(),
    };
    let refusal = |source| DataError::Camera {
        path: "orbbec".into(),
        source,
    };
    let side = |pixels: i16| usize::try_from(pixels).unwrap_or(0);
    let camera = Camera::new(side(k.width), side(k.height), intrinsics).map_err(refusal)?;
    if [lens.k4, lens.k5, lens.k6] != [0.0; 3] {
        return Err(fault(
            "its lens needs the rational model, which only the ros2 kind takes",
        ));
    }
    let distortion = [lens.k1, lens.k2, lens.p1, lens.p2, lens.k3].map(f64::from);
    let distortion = (distortion != [0.0; 5]).then_some(distortion);
    CameraFile::new(camera, distortion, DEPTH_SCALE.into()).map_err(refusal)
}
