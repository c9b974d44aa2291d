//! Stray Scanner: a folder of `odometry.csv`, `camera_matrix.csv`, `depth/NNNNNN.png` (millimetres),
//! `confidence/NNNNNN.png` (0 to 2) and `rgb.mp4`.
//!
//! Poses are of the camera in our axes already: the app turns ARKit's. The video is HEVC: its images are
//! taken from `rgb/` if they are there, else they are decoded by ffmpeg.

use std::collections::HashMap;
use std::path::Path;

use fgs_data::{DataError, Format, SourcedRecording, natural_order};
use fgs_geom::{Intrinsics, Se3};

use crate::camera_file::pinhole;
use crate::fault::fault;
use crate::intrinsics::median;
use crate::phone_poses::trajectory;
use crate::tree::Tree;
use crate::tree_frames::{ColorFile, DepthCoding, TreeFrame, TreeFrames, size_of};
use crate::video::Video;

const ODOMETRY: &str = "odometry.csv";
const CAMERA: &str = "camera_matrix.csv";
const VIDEO: &str = "rgb.mp4";
const COLOR: &str = "rgb";

/// A matrix of nine numbers.
const MAX_CAMERA_BYTES: u64 = 64 * 1024;

/// An hour of 60 frames a second has 40 MB of lines.
const MAX_ODOMETRY_BYTES: u64 = 256 * 1024 * 1024;

/// Whether a tree is such a recording.
pub(crate) fn is_one(tree: &Tree) -> bool {
    tree.has(ODOMETRY) && tree.has(CAMERA)
}

/// One line of `odometry.csv`.
struct Row {
    number: u64,
    timestamp_secs: f64,
    pose: Option<Se3>,
    intrinsics: Option<Intrinsics>,
}

/// Opens one.
///
/// # Errors
/// If a list is damaged, the video's images are not there, or no frame is complete.
pub(crate) fn open(tree: Tree) -> Result<SourcedRecording, DataError> {
    let camera_path = tree.shown(CAMERA);
    let matrix = read_matrix(&tree)?;
    let rows = read_odometry(&tree)?;
    let Colors { files, video, size } = colors_of(&tree, &rows)?;
    let names = |folder: &str| -> Result<HashMap<u64, String>, DataError> {
        let names = tree.names_in(folder)?.into_iter();
        let numbered = names.filter_map(|name| {
            let number = name.strip_suffix(".png")?.parse().ok()?;
            Some((number, format!("{folder}/{name}")))
        });
        Ok(numbered.collect())
    };
    let (mut depths, mut confidences) = (names("depth")?, names("confidence")?);
    let mut frames = Vec::new();
    let mut kept = Vec::new();
    for (row, color) in rows.iter().zip(files) {
        if let (Some(color), Some(depth)) = (color, depths.remove(&row.number)) {
            frames.push(TreeFrame {
                color,
                depth,
                confidence: confidences.remove(&row.number),
                intrinsics: row.intrinsics,
            });
            kept.push(row);
        }
    }
    // All or none: a frame without would be seen through another lens.
    let own: Option<Vec<Intrinsics>> = kept.iter().map(|row| row.intrinsics).collect();
    if own.is_none() {
        frames.iter_mut().for_each(|frame| frame.intrinsics = None);
    }
    let common = own.as_deref().and_then(median).unwrap_or(matrix);
    if frames.is_empty() {
        return Err(DataError::Empty {
            path: tree.shown("depth"),
            what: "PNG image by the number of a frame in odometry.csv",
        });
    }
    let depth_coding = DepthCoding::Png {
        units_per_m: 1000.0,
    };
    let frames = TreeFrames::new(tree, frames, depth_coding, size, common, &camera_path)?;
    let timestamps: Vec<f64> = kept.iter().map(|row| row.timestamp_secs).collect();
    Ok(SourcedRecording {
        format: Format::StrayScanner,
        camera: pinhole(frames.camera(), &camera_path)?,
        device_poses: trajectory(&timestamps, kept.iter().map(|row| row.pose)),
        timestamps,
        source: Box::new(frames.with_video(video)),
    })
}

fn read_matrix(tree: &Tree) -> Result<Intrinsics, DataError> {
    let path = tree.shown(CAMERA);
    let text = text(tree.read(CAMERA, MAX_CAMERA_BYTES)?, &path)?;
    let numbers = text.split([',', '\n']).map(str::trim);
    let numbers: Result<Vec<f64>, _> = numbers
        .filter(|number| !number.is_empty())
        .map(str::parse)
        .collect();
    match numbers.as_deref() {
        Ok(&[fx, _, cx, _, fy, cy, _, _, _]) => Ok(Intrinsics { fx, fy, cx, cy }),
        _ => Err(fault(&path, "must hold a matrix of 3 x 3 numbers".into())),
    }
}

fn read_odometry(tree: &Tree) -> Result<Vec<Row>, DataError> {
    let path = tree.shown(ODOMETRY);
    let text = text(tree.read(ODOMETRY, MAX_ODOMETRY_BYTES)?, &path)?;
    let mut lines = text.lines();
    let header: Vec<&str> = lines
        .next()
        .map(|line| line.split(',').map(str::trim).collect())
        .unwrap_or_default();
    let column = |name: &str| header.iter().position(|column| *column == name);
    let (Some(time), Some(frame)) = (column("timestamp"), column("frame")) else {
        return Err(fault(
            &path,
            "the first line must name the columns timestamp and frame".into(),
        ));
    };
    let pose_columns = ["qw", "qx", "qy", "qz", "x", "y", "z"].map(column);
    let lens_columns = ["fx", "fy", "cx", "cy"].map(column);
    let mut rows: Vec<Row> = Vec::new();
    for (index, line) in lines.enumerate() {
        if line.trim().is_empty() {
            continue;
        }
        let refuse = |what: &str| fault(&path, format!("line {}: {what}", index + 2));
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        let cell = |column: usize| cells.get(column).copied().unwrap_or_default();
        let number = |column: Option<usize>| cell(column?).parse::<f64>().ok();
        let timestamp_secs = number(Some(time))
            .filter(|secs| secs.is_finite())
            .ok_or_else(|| refuse("the time stamp is no number"))?;
        let frame_number = cell(frame)
            .parse()
            .map_err(|_| refuse("the frame is no number"))?;
        if let Some(last) = rows.last()
            && last.timestamp_secs >= timestamp_secs
        {
            return Err(refuse("its time stamp does not come after the one before"));
        }
        let [qw, qx, qy, qz, x, y, z] = pose_columns.map(number);
        let pose = || Se3::from_wxyz([qw?, qx?, qy?, qz?], [x?, y?, z?]);
        let [fx, fy, cx, cy] = lens_columns.map(number);
        let intrinsics = || {
            Some(Intrinsics {
                fx: fx.filter(|fx| *fx > 1.0)?,
                fy: fy.filter(|fy| *fy > 1.0)?,
                cx: cx?,
                cy: cy?,
            })
        };
        rows.push(Row {
            number: frame_number,
            timestamp_secs,
            pose: pose(),
            intrinsics: intrinsics(),
        });
    }
    Ok(rows)
}

/// The colour images of all rows.
struct Colors {
    /// That of each row, if there is one.
    files: Vec<Option<ColorFile>>,
    video: Option<Video>,
    size: (usize, usize),
}

/// Takes the images in `rgb/`, else those of the video, if ffmpeg is installed.
fn colors_of(tree: &Tree, rows: &[Row]) -> Result<Colors, DataError> {
    let names = image_names(tree)?;
    if let Some(first) = names.first() {
        let size = size_of(tree, first)?;
        return Ok(Colors {
            files: files_of(tree, rows, &names)?,
            video: None,
            size,
        });
    }
    let video = match tree.path_of(VIDEO) {
        Some(path) => Video::open(&path)?,
        None => None,
    };
    let Some(video) = video else {
        return Err(fault(&tree.shown(VIDEO), how_to_extract(tree)));
    };
    let first = video.frame(0)?;
    let files = (0..rows.len()).map(|place| Some(ColorFile::InVideo(place)));
    Ok(Colors {
        files: files.collect(),
        size: (first.width(), first.height()),
        video: Some(video),
    })
}

/// The images that the video was turned into, in order.
fn image_names(tree: &Tree) -> Result<Vec<String>, DataError> {
    let mut names = tree.names_in(COLOR)?;
    names.retain(|name| {
        let extension = name.rsplit('.').next().unwrap_or_default();
        ["png", "jpg", "jpeg"].contains(&extension.to_ascii_lowercase().as_str())
    });
    names.sort_by(|a, b| natural_order(a, b));
    Ok(names.iter().map(|name| format!("{COLOR}/{name}")).collect())
}

/// The image of each row: in order, if there are as many; else by the numbers of their names, which begin
/// at 0 like the rows' do.
fn files_of(
    tree: &Tree,
    rows: &[Row],
    names: &[String],
) -> Result<Vec<Option<ColorFile>>, DataError> {
    let own = |name: &String| Some(ColorFile::Own(name.clone()));
    if names.len() == rows.len() {
        return Ok(names.iter().map(own).collect());
    }
    let number = |name: &String| -> Option<usize> {
        let (_, name) = name.rsplit_once('/')?;
        name.split_once('.')?.0.parse().ok()
    };
    let numbered: HashMap<usize, &String> = names
        .iter()
        .filter_map(|name| Some((number(name)?, name)))
        .collect();
    if !numbered.contains_key(&0) {
        return Err(fault(
            &tree.shown(COLOR),
            format!(
                "holds {} images, but odometry.csv has {} frames, and no image is number 0: {}",
                names.len(),
                rows.len(),
                how_to_extract(tree)
            ),
        ));
    }
    let places = 0..rows.len();
    Ok(places
        .map(|place| numbered.get(&place).copied().and_then(own))
        .collect())
}

/// The command that turns the video into images: every frame once, as recorded.
fn how_to_extract(tree: &Tree) -> String {
    let (video, folder) = (tree.shown(VIDEO), tree.shown(COLOR));
    format!(
        "the program ffmpeg, which decodes the video, is not installed, or the video is in an archive: turn \
         it into images: mkdir -p '{folder}' && ffmpeg -noautorotate -i \
         '{video}' -fps_mode passthrough -start_number 0 -q:v 2 '{folder}/%06d.jpg'",
        folder = folder.display(),
        video = video.display(),
    )
}

fn text(bytes: Vec<u8>, path: &Path) -> Result<String, DataError> {
    String::from_utf8(bytes).map_err(|_| fault(path, "is no text".into()))
}
