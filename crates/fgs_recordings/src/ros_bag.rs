//! A ROS 2 bag: one MCAP file, or a folder of several that follow each other.
//!
//! Of the bag's topics that pair of a colour and a depth image is taken whose pixels are the same: depth
//! in the frame of the colour camera. Images are paired by the times in their headers, when they were
//! taken; when they were written says less.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use fgs_data::{
    DataError, Format, FrameImages, FrameSource, OpenOptions, SourcedRecording, associate,
    natural_order,
};

use crate::fault::{fault, io_fault};
use crate::mcap_file::McapFile;
use crate::ros_camera::{ImageTopic, REGISTERED, RosCamera, damaged, stamp_secs};
use crate::ros_messages::CameraInfo;

const IMAGE: &str = "sensor_msgs/msg/Image";
const COMPRESSED_IMAGE: &str = "sensor_msgs/msg/CompressedImage";
const CAMERA_INFO: &str = "sensor_msgs/msg/CameraInfo";

/// Where a message is, and when it was taken.
#[derive(Clone, Copy)]
struct Message {
    file: usize,
    log_time: u64,
    secs: f64,
}

/// The frames of a bag.
struct BagFrames {
    files: Vec<McapFile>,
    camera: RosCamera,
    /// Colour and depth of each frame.
    frames: Vec<(Message, Message)>,
}

/// The MCAP files at a path: itself, or those in the folder in their order. None if there is none.
///
/// # Errors
/// If the folder cannot be read.
pub(crate) fn files_at(path: &Path) -> Result<Vec<PathBuf>, DataError> {
    if !path.is_dir() {
        let is_one = McapFile::is_one(path);
        return Ok(is_one.then(|| path.to_owned()).into_iter().collect());
    }
    let read = || -> std::io::Result<Vec<PathBuf>> {
        let entries = std::fs::read_dir(path)?;
        entries.map(|entry| Ok(entry?.path())).collect()
    };
    let mut files = read().map_err(|source| io_fault(path, source))?;
    files.retain(|file| {
        file.extension()
            .is_some_and(|extension| extension == "mcap")
    });
    let name = |file: &Path| file.to_string_lossy().into_owned();
    files.sort_by(|a, b| natural_order(&name(a), &name(b)));
    Ok(files)
}

/// Opens a bag. `files` is not empty.
///
/// # Errors
/// If a file is damaged, or no colour and depth images fit together.
pub(crate) fn open(
    path: &Path,
    files: &[PathBuf],
    options: &OpenOptions,
) -> Result<SourcedRecording, DataError> {
    let files: Result<Vec<McapFile>, DataError> =
        files.iter().map(|file| McapFile::open(file)).collect();
    let files = files?;
    let topics: BTreeMap<String, String> = files.iter().flat_map(McapFile::topics).collect();
    let (color, depth) = choose(path, image_topics(&files, &topics)?)?;
    let info = camera_info(path, &files, &topics, &color)?;
    let [colors, depths] = messages(&files, [&color.name, &depth.name])?;
    let secs = |messages: &[Message]| messages.iter().map(|m| m.secs).collect::<Vec<_>>();
    let pairs = associate(
        &secs(&colors),
        &secs(&depths),
        options.max_time_difference_secs,
    );
    if pairs.is_empty() {
        return Err(fault(
            path,
            format!(
                "no image of {} was taken when one of {} was",
                color.name, depth.name
            ),
        ));
    }
    let frames: Vec<(Message, Message)> = pairs
        .into_iter()
        .map(|(color, depth)| (colors[color], depths[depth]))
        .collect();
    let camera = RosCamera::new(path, &info, color, depth)?;
    Ok(SourcedRecording {
        format: Format::Mcap,
        camera: camera.camera_file().clone(),
        timestamps: frames.iter().map(|(color, _)| color.secs).collect(),
        device_poses: Ok(None),
        source: Box::new(BagFrames {
            files,
            camera,
            frames,
        }),
    })
}

/// The topics with images that are understood, as their first messages say.
fn image_topics(
    files: &[McapFile],
    topics: &BTreeMap<String, String>,
) -> Result<Vec<ImageTopic>, DataError> {
    let mut found = Vec::new();
    for (name, schema) in topics {
        let is_compressed = schema == COMPRESSED_IMAGE;
        if schema != IMAGE && !is_compressed {
            continue;
        }
        let of_first =
            |path: &Path, message: &[u8]| ImageTopic::of(path, name, is_compressed, message).ok();
        found.extend(first(files, name, of_first)?.flatten());
    }
    Ok(found)
}

/// What `read` makes of a topic's first message, if it has one.
fn first<T>(
    files: &[McapFile],
    topic: &str,
    read: impl Fn(&Path, &[u8]) -> T,
) -> Result<Option<T>, DataError> {
    for file in files {
        let mut found = None;
        file.visit(&[topic], None, |_, _, message| {
            found = Some(read(file.path(), message));
            ControlFlow::Break(())
        })?;
        if found.is_some() {
            return Ok(found);
        }
    }
    Ok(None)
}

/// The pair of topics that shows colour and depth of the same pixels.
fn choose(path: &Path, topics: Vec<ImageTopic>) -> Result<(ImageTopic, ImageTopic), DataError> {
    let (mut depths, mut colors): (Vec<_>, Vec<_>) =
        topics.into_iter().partition(|topic| topic.is_depth);
    let name_says =
        |topic: &ImageTopic, words: &[&str]| words.iter().any(|word| topic.name.contains(word));
    let mut best: Option<(u32, usize, usize)> = None;
    for (c, color) in colors.iter().enumerate() {
        for (d, depth) in depths.iter().enumerate() {
            if !depth.is_registered_to(color) {
                continue;
            }
            let points = [
                (!color.is_grey, 32),
                (name_says(color, &["color", "rgb"]), 16),
                (depth.is_of_camera(color), 8),
                (name_says(depth, &REGISTERED), 4),
                (!depth.is_compressed, 2),
                (!color.is_compressed, 1),
            ];
            let points = points.iter().filter(|(holds, _)| *holds);
            let score = points.map(|(_, points)| points).sum();
            if best.is_none_or(|(most, ..)| score > most) {
                best = Some((score, c, d));
            }
        }
    }
    match best {
        Some((_, c, d)) => Ok((colors.swap_remove(c), depths.swap_remove(d))),
        None => {
            let list = |topics: &[ImageTopic]| match topics {
                [] => "none".to_owned(),
                topics => {
                    let names = topics
                        .iter()
                        .map(|t| format!("{} in {:?}", t.name, t.frame));
                    names.collect::<Vec<_>>().join(", ")
                }
            };
            Err(fault(
                path,
                format!(
                    "no depth is registered to a colour camera (colour: {}; depth: {}): record depth that \
                     the driver has aligned to colour, in the colour camera's frame",
                    list(&colors),
                    list(&depths)
                ),
            ))
        }
    }
}

/// The calibration of a colour topic: `camera_info` beside it, else that of the same frame.
fn camera_info(
    path: &Path,
    files: &[McapFile],
    topics: &BTreeMap<String, String>,
    color: &ImageTopic,
) -> Result<CameraInfo, DataError> {
    let raw = color.name.strip_suffix("/compressed");
    let raw = raw.unwrap_or(&color.name);
    let beside = raw
        .rsplit_once('/')
        .map(|(parent, _)| format!("{parent}/camera_info"));
    let infos = topics.iter().filter(|(_, schema)| *schema == CAMERA_INFO);
    let mut names: Vec<&String> = infos.map(|(name, _)| name).collect();
    // The sort is stable: what is beside comes first.
    names.sort_by_key(|name| Some(*name) != beside.as_ref());
    for name in names {
        let info = first(files, name, |_, message| CameraInfo::read(message).ok())?;
        if let Some(info) = info.flatten()
            && (info.width, info.height) == color.size
            && (Some(name) == beside.as_ref() || info.header.frame == color.frame)
        {
            return Ok(info);
        }
    }
    Err(fault(
        path,
        format!(
            "no camera_info of {}x{} pixels belongs to {}",
            color.size.0, color.size.1, color.name
        ),
    ))
}

/// The messages of two topics, each later than the one before.
fn messages(files: &[McapFile], topics: [&str; 2]) -> Result<[Vec<Message>; 2], DataError> {
    let mut messages = [Vec::new(), Vec::new()];
    for (file, bag) in files.iter().enumerate() {
        bag.visit(&topics, None, |topic, log_time, message| {
            // What is damaged is no frame.
            if let Some(secs) = stamp_secs(message) {
                messages[usize::from(topic == topics[1])].push(Message {
                    file,
                    log_time,
                    secs,
                });
            }
            ControlFlow::Continue(())
        })?;
    }
    for messages in &mut messages {
        messages.sort_by(|a, b| a.secs.total_cmp(&b.secs));
        messages.dedup_by(|a, b| a.secs == b.secs);
    }
    Ok(messages)
}

impl FrameSource for BagFrames {
    fn read(&self, index: usize) -> Result<FrameImages, DataError> {
        let (color, depth) = self.frames.get(index).ok_or(DataError::NoSuchFrame {
            index,
            len: self.frames.len(),
        })?;
        let camera = &self.camera;
        let color = self.image(&camera.color, color, |path, message| {
            camera.color(path, message)
        })?;
        let depth_m = self.image(&camera.depth, depth, |path, message| {
            camera.depth_m(path, message)
        })?;
        Ok(camera.joined(&color, &depth_m))
    }
}

impl BagFrames {
    fn image<T>(
        &self,
        topic: &ImageTopic,
        message: &Message,
        decode: impl Fn(&Path, &[u8]) -> Result<T, DataError>,
    ) -> Result<T, DataError> {
        let file = &self.files[message.file];
        let path = file.path();
        let mut decoded = None;
        file.visit(&[&topic.name], Some(message.log_time), |_, _, bytes| {
            // Others may have been written at the same time.
            if stamp_secs(bytes).is_some_and(|secs| secs != message.secs) {
                return ControlFlow::Continue(());
            }
            decoded = Some(decode(path, bytes));
            ControlFlow::Break(())
        })?;
        decoded.unwrap_or_else(|| Err(damaged(path, topic)))
    }
}
