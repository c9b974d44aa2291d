//! The camera: its stream has a thread of its own, since parts of librealsense's objects stay on the thread
//! that made them.

use std::io;
use std::thread::Builder;

use crossbeam_channel::{Receiver, Sender, bounded};
use fgs_data::{CameraFile, CameraSource, DataError, LiveImages};
use thiserror::Error;

use crate::stream::Stream;

/// Why a camera cannot be used.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RealsenseError {
    /// None is plugged in, or none with that serial number.
    #[error("no RealSense camera is found{}", serial.as_ref().map(|it| format!(" with serial number {it}")).unwrap_or_default())]
    NoCamera {
        /// The number that was asked for.
        serial: Option<String>,
    },
    /// librealsense refused something.
    #[error("librealsense: {0}")]
    Sdk(String),
    /// Its lens is not understood, or out of range.
    #[error(transparent)]
    Lens(#[from] DataError),
    /// No thread starts.
    #[error(transparent)]
    Thread(#[from] io::Error),
}

impl RealsenseError {
    /// Of an error of the SDK, whose kinds have no type in common.
    pub(crate) fn sdk(error: impl std::fmt::Display) -> Self {
        Self::Sdk(error.to_string())
    }
}

/// Images of a RealSense camera.
pub struct RealsenseCamera {
    file: CameraFile,
    images: Receiver<Result<LiveImages, DataError>>,
}

/// Starts a camera: the one with a serial number, or the first if that is empty.
///
/// # Errors
/// If there is none, or it cannot be started.
pub fn open(serial: &str) -> Result<RealsenseCamera, RealsenseError> {
    let serial = (!serial.is_empty()).then(|| serial.to_owned());
    let (started, starting) = bounded(1);
    let (sender, images) = bounded(1);
    let work = move || deliver(serial, &started, &sender);
    Builder::new().name("realsense".into()).spawn(work)?;
    let file = starting
        .recv()
        .unwrap_or_else(|_| Err(RealsenseError::Sdk("it stopped at once".into())))?;
    Ok(RealsenseCamera { file, images })
}

/// Until nobody takes the images, or none come any more.
fn deliver(
    serial: Option<String>,
    started: &Sender<Result<CameraFile, RealsenseError>>,
    images: &Sender<Result<LiveImages, DataError>>,
) {
    let mut stream = match Stream::start(serial) {
        Ok(stream) => stream,
        Err(error) => {
            // Whoever opens it is waiting.
            let _ = started.send(Err(error));
            return;
        }
    };
    let _ = started.send(Ok(stream.camera_file().clone()));
    while let Some(next) = stream.next() {
        if images.send(next).is_err() {
            return;
        }
    }
}

impl CameraSource for RealsenseCamera {
    fn camera_file(&self) -> &CameraFile {
        &self.file
    }

    /// Ends when the camera is unplugged.
    fn next_images(&mut self) -> Option<Result<LiveImages, DataError>> {
        self.images.recv().ok()
    }
}
