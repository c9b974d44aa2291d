//! A run that is shown, from before it starts until it ends.

use std::fs::File;
use std::io::{self, Read};
use std::net::{Ipv4Addr, SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use fgs_data::Trajectory;
use fgs_files::NewFile;
use fgs_geom::Camera;
use fgs_slam::Slam;
use fgs_splat::Gaussians;
use fgs_view::{SiteKeyframe, watch};
use re_sdk::sink::{FileSink, GrpcSink, LogSink};
use re_sdk::{DEFAULT_SERVER_PORT, RecordingStreamBuilder};

use crate::blueprint::blueprint;
use crate::error::RerunError;
use crate::recorder::Recorder;

/// Of the library, and so of viewers that surely understand it.
const VERSION: &str = "0.36.3";
/// What Rerun's recordings begin with.
const MAGIC: &[u8] = b"RRF";
/// To wait for a viewer on the same machine.
const CONNECT: Duration = Duration::from_secs(2);
/// To wait at the end for what is left.
const FAREWELL: Duration = Duration::from_secs(30);

/// Where runs are shown, before there is one.
pub struct Outputs {
    sinks: Vec<Box<dyn LogSink>>,
    file: Option<(PathBuf, NewFile)>,
}

impl Outputs {
    /// The viewer that runs on this machine, a file, or both.
    ///
    /// # Errors
    /// If no viewer runs, or the file cannot be written or is another program's.
    pub fn open(viewer: bool, file: Option<&Path>) -> Result<Self, RerunError> {
        let mut sinks: Vec<Box<dyn LogSink>> = Vec::new();
        if viewer {
            check_viewer()?;
            sinks.push(Box::new(GrpcSink::default()));
        }
        let file = match file {
            Some(path) => Some((path.to_owned(), begin_file(path)?)),
            None => None,
        };
        if let Some((_, file)) = &file {
            sinks.push(Box::new(FileSink::new(file.path())?));
        }
        Ok(Self { sinks, file })
    }
}

/// What a run has come to. The map and the poses `world_from_camera` are of its largest sub-map.
pub struct Outcome<'a> {
    /// The map.
    pub map: &'a Gaussians,
    /// All keyframes.
    pub keyframes: &'a [SiteKeyframe],
    /// The poses of all tracked frames.
    pub trajectory: &'a Trajectory,
    /// Those of the recording, moved to the run's coordinates.
    pub reference: Option<&'a Trajectory>,
}

/// A run that is shown in Rerun, from before it starts until it ends.
pub struct RerunView {
    file: Option<(PathBuf, NewFile)>,
    recorder: Option<Recorder>,
    thread: Option<JoinHandle<Recorder>>,
}

impl RerunView {
    /// Begins to show a run called `title` of a camera.
    ///
    /// # Errors
    /// If no stream can be made.
    pub fn start(outputs: Outputs, title: &str, camera: &Camera) -> Result<Self, RerunError> {
        let stream = RecordingStreamBuilder::new("fgs-slam")
            .recording_name(title)
            .with_blueprint(blueprint())
            .set_sinks(outputs.sinks)?;
        Ok(Self {
            file: outputs.file,
            recorder: Some(Recorder::new(stream, camera)?),
            thread: None,
        })
    }

    /// Looks on from now on, until the session ends.
    ///
    /// # Errors
    /// If no thread starts.
    pub fn watch(&mut self, session: &Slam) -> Result<(), RerunError> {
        if let Some(recorder) = self.recorder.take() {
            self.thread = Some(watch(session, recorder).map_err(RerunError::Thread)?);
        }
        Ok(())
    }

    /// The run is over: shows what it has come to, if it has, and finishes the file.
    ///
    /// # Errors
    /// If something could not be shown or written.
    pub fn end(self, outcome: Option<&Outcome<'_>>) -> Result<(), RerunError> {
        let recorder = self.recorder.map(Ok).or(self.thread.map(joined));
        if let Some(recorder) = recorder.transpose()? {
            let stream = recorder.end(outcome)?;
            stream.flush_with_timeout(FAREWELL)?;
            // Writes the file's end.
            drop(stream);
        }
        match self.file {
            Some((path, file)) => file
                .finish()
                .map_err(|source| RerunError::Write { path, source }),
            None => Ok(()),
        }
    }
}

/// Waits for a thread whose session has ended, but not for ever: it may wait for a viewer.
fn joined(thread: JoinHandle<Recorder>) -> Result<Recorder, RerunError> {
    let start = Instant::now();
    while !thread.is_finished() {
        if start.elapsed() > FAREWELL {
            return Err(RerunError::TooSlow);
        }
        thread::sleep(Duration::from_millis(5));
    }
    thread.join().map_err(|_| RerunError::Panicked)
}

fn check_viewer() -> Result<(), RerunError> {
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, DEFAULT_SERVER_PORT));
    match TcpStream::connect_timeout(&address, CONNECT) {
        Ok(_) => Ok(()),
        Err(_) => Err(RerunError::NoViewer {
            address,
            version: VERSION,
        }),
    }
}

fn begin_file(path: &Path) -> Result<NewFile, RerunError> {
    let cannot_write = |source| RerunError::Write {
        path: path.into(),
        source,
    };
    if path.symlink_metadata().is_ok() && !is_recording(path).map_err(cannot_write)? {
        return Err(RerunError::Foreign { path: path.into() });
    }
    NewFile::begin(path).map_err(cannot_write)
}

fn is_recording(path: &Path) -> io::Result<bool> {
    let file: File = fgs_files::open_regular(path)?;
    let mut start = Vec::new();
    file.take(MAGIC.len() as u64).read_to_end(&mut start)?;
    Ok(start == MAGIC)
}
