//! RGB-D recordings as other programs write them, opened like plain folders.
//!
//! [`open`] recognises a recording by what it holds, never by its name alone, and gives a
//! [`fgs_data::Dataset`]: everything that works with a plain folder works with it. Images are read from
//! where they are, frame by frame; nothing is unpacked, and no file is written.
//!
//! Invariants: input is untrusted. Sizes are bounded before anything is allocated for them, and only
//! regular files below the given path are opened.

mod camera_file;
mod cdr;
mod colmap;
mod depth_upsampling;
mod fault;
mod intrinsics;
mod mcap_file;
mod nerfstudio;
mod phone_poses;
mod plain_folder;
mod polycam;
mod rational_lens;
mod record3d;
mod ros_bag;
mod ros_camera;
mod ros_messages;
mod stray_scanner;
mod tree;
mod tree_frames;
mod video;
mod working_image;

use std::path::Path;

use fgs_data::{DataError, Dataset, OpenOptions};
use fgs_files::is_present;

pub use plain_folder::{WriteError, write_plain};
pub use ros_camera::{ImageTopic, RosCamera, stamp_secs};

use crate::tree::Tree;

/// Opens a recording of any known kind: a folder or a file.
///
/// A folder with a `camera.toml` is a plain one, whatever else is in it: somebody has said how it is to be
/// read. The camera in `options` takes the place of the recording's own.
///
/// # Errors
/// If nothing known is there, or it is damaged.
pub fn open(path: &Path, options: &OpenOptions) -> Result<Dataset, DataError> {
    if !is_present(path) || is_present(&path.join("camera.toml")) {
        return Dataset::open(path, options);
    }
    let bags = ros_bag::files_at(path)?;
    if !bags.is_empty() {
        return Dataset::from_source(path, ros_bag::open(path, &bags, options)?, options);
    }
    if let Some(tree) = Tree::open(path)? {
        let opened = if record3d::is_one(&tree) {
            record3d::open(tree)?
        } else if stray_scanner::is_one(&tree) {
            stray_scanner::open(tree)?
        } else if polycam::is_one(&tree) {
            polycam::open(tree)?
        } else if nerfstudio::is_one(&tree) {
            nerfstudio::open(tree)?
        } else if colmap::is_one(&tree) {
            colmap::open(tree)?
        } else {
            return plain(path, options);
        };
        return Dataset::from_source(path, opened, options);
    }
    Err(DataError::UnknownRecording(path.into()))
}

/// Opens a plain folder.
fn plain(path: &Path, options: &OpenOptions) -> Result<Dataset, DataError> {
    Dataset::open(path, options).map_err(|error| match error {
        DataError::UnknownFormat(path) | DataError::NotAFolder(path) => {
            DataError::UnknownRecording(path)
        }
        error => error,
    })
}
