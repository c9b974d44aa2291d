//! Everything that reads foreign bytes, and the two numerical cores, fed with any bytes.
//!
//! Each function takes what a fuzzer makes up and must return: a refusal is as good as an answer, a
//! panic is not, nor is a result that breaks its promise. The targets in `fuzz/` call them; the test of
//! this crate replays the corpus, and makes up bytes of its own.

#![allow(
    clippy::unwrap_used,
    reason = "what is prepared here must work, or the target tests nothing"
)]

mod numbers;
mod readers;
mod recordings;
mod requests;

pub use numbers::{align, model_step};
pub use readers::{
    camera_file, color_image, depth_image, lists, map, matrices, run_folder, settings, trajectory,
};
pub use recordings::{archive, bag, phone};
pub use requests::request;

/// A target by its name.
pub type Target = (&'static str, fn(&[u8]));

/// All of them. A target's corpus is `fuzz/corpus/NAME`.
pub const TARGETS: [Target; 15] = [
    ("align", align),
    ("archive", archive),
    ("bag", bag),
    ("camera_file", camera_file),
    ("color_image", color_image),
    ("depth_image", depth_image),
    ("lists", lists),
    ("map", map),
    ("matrices", matrices),
    ("model_step", model_step),
    ("phone", phone),
    ("request", request),
    ("run_folder", run_folder),
    ("settings", settings),
    ("trajectory", trajectory),
];
