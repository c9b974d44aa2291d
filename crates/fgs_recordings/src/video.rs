//! Images of a video, decoded by the program `ffmpeg` where it is installed.
//!
//! Phones record HEVC, for which there is no decoder to build in. ffmpeg writes one image after another
//! into a pipe; nothing is written to the disk. Frames are counted, not timed: the n-th image of the video
//! is the n-th that was recorded.

use std::collections::VecDeque;
use std::ffi::OsString;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::{Mutex, PoisonError};
use std::thread::available_parallelism;

use fgs_data::DataError;
use fgs_geom::Image;

use crate::fault::{fault, io_fault};

const PROGRAM: &str = "ffmpeg";

/// A hundred megapixels, as of any camera.
const MAX_PIXELS: usize = 100_000_000;

/// The header of an image in a pipe takes some twenty bytes.
const MAX_HEADER_LINE_BYTES: u64 = 64;

/// Several threads ask for frames that follow each other, hardly in order: this many more than there are
/// threads are kept.
const KEPT_BEYOND_THREADS: usize = 4;

/// 200 MB of a phone's images.
const MAX_KEPT: usize = 24;

type Color = Image<[u8; 3]>;

/// A video that is decoded from front to back, and again from anywhere.
pub(crate) struct Video {
    path: PathBuf,
    decoding: Mutex<Decoding>,
}

#[derive(Default)]
struct Decoding {
    pipe: Option<Pipe>,
    /// The frame that the pipe gives next.
    next: usize,
    /// The frames last decoded.
    kept: VecDeque<(usize, Color)>,
}

/// A decoder at work.
struct Pipe {
    program: Child,
    images: BufReader<ChildStdout>,
}

impl Video {
    /// Opens a video file; `None` if ffmpeg is not installed.
    ///
    /// # Errors
    /// If it is no regular file.
    pub fn open(path: &Path) -> Result<Option<Self>, DataError> {
        fgs_files::check_regular(path).map_err(|source| io_fault(path, source))?;
        match Pipe::open(path, 0) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(io_fault(Path::new(PROGRAM), error)),
            Ok(pipe) => Ok(Some(Self {
                path: path.into(),
                decoding: Mutex::new(Decoding {
                    pipe: Some(pipe),
                    ..Decoding::default()
                }),
            })),
        }
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The frame at `index`.
    ///
    /// # Errors
    /// If ffmpeg cannot be started, does not understand the video, or it is shorter.
    pub fn frame(&self, index: usize) -> Result<Color, DataError> {
        let decoding = &mut *self.decoding.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, image)) = decoding.kept.iter().find(|(kept, _)| *kept == index) {
            return Ok(image.clone());
        }
        if decoding.pipe.is_none() || index < decoding.next || index > decoding.next + MAX_KEPT {
            // What is skipped is decoded, but does not go through the pipe.
            decoding.pipe = None;
            let pipe = Pipe::open(&self.path, index);
            decoding.pipe = Some(pipe.map_err(|error| io_fault(Path::new(PROGRAM), error))?);
            decoding.next = index;
            decoding.kept.clear();
        }
        loop {
            let image = match decoding.pipe.as_mut().map(|pipe| pipe.read()) {
                Some(Ok(image)) => image,
                Some(Err(error)) => {
                    decoding.pipe = None;
                    let message = format!("ffmpeg gives no image {index}: {error}");
                    return Err(fault(&self.path, message));
                }
                None => return Err(fault(&self.path, "ffmpeg has ended".into())),
            };
            let place = decoding.next;
            decoding.next += 1;
            if place == index {
                decoding.keep(place, image.clone());
                return Ok(image);
            }
            decoding.keep(place, image);
        }
    }
}

impl Decoding {
    fn keep(&mut self, place: usize, image: Color) {
        let threads = available_parallelism().map_or(1, |threads| threads.get());
        if self.kept.len() >= (threads + KEPT_BEYOND_THREADS).min(MAX_KEPT) {
            self.kept.pop_front();
        }
        self.kept.push_back((place, image));
    }
}

impl Pipe {
    /// Starts a decoder at a frame.
    fn open(path: &Path, first: usize) -> io::Result<Self> {
        // A name that begins with a dash is no option, and one with a colon no protocol.
        let mut input = OsString::from("file:");
        input.push(path);
        let mut command = Command::new(PROGRAM);
        // Ctrl-C is for this program, which goes on to save.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut program = command
            .args(["-v", "error", "-nostdin", "-protocol_whitelist", "file"])
            // As it was recorded, as depth is: not turned for those who look at it.
            .args(["-noautorotate", "-f", "mov", "-i"])
            .arg(input)
            .args(["-map", "0:v:0", "-fps_mode", "passthrough"])
            .args(["-vf", &format!("select=gte(n\\,{first})")])
            .args(["-c:v", "ppm", "-f", "image2pipe", "pipe:1"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()?;
        let images = program.stdout.take().ok_or(io::ErrorKind::BrokenPipe)?;
        Ok(Self {
            program,
            images: BufReader::new(images),
        })
    }

    /// The next image, in PPM: `P6`, columns, rows and 255 in lines of text, then the pixels.
    fn read(&mut self) -> io::Result<Color> {
        let not_understood = || io::Error::new(io::ErrorKind::InvalidData, "no image follows");
        let mut line = || -> io::Result<String> {
            let mut line = String::new();
            (&mut self.images)
                .take(MAX_HEADER_LINE_BYTES)
                .read_line(&mut line)?;
            if line.is_empty() {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
            Ok(line.trim_end().to_owned())
        };
        let (magic, size, largest) = (line()?, line()?, line()?);
        let size = size.split_once(' ').and_then(|(width, height)| {
            let size: (usize, usize) = (width.parse().ok()?, height.parse().ok()?);
            (size.0.saturating_mul(size.1) <= MAX_PIXELS).then_some(size)
        });
        let (Some((width, height)), "P6", "255") = (size, magic.as_str(), largest.as_str()) else {
            return Err(not_understood());
        };
        let mut pixels = vec![[0; 3]; width * height];
        self.images.read_exact(pixels.as_flattened_mut())?;
        Image::new(width, height, pixels).map_err(|_| not_understood())
    }
}

impl Drop for Pipe {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.program.kill();
        let _ = self.program.wait();
    }
}
