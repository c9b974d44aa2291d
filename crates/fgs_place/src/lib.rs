//! Place recognition for RGB-D frames: which keyframes show what a frame shows, without knowing
//! where the camera is. A lost camera finds its way back by it, and loops are found.
//!
//! Randomised ferns on small colour-depth images, after Glocker, Shotton, Criminisi and Izadi,
//! "Real-Time RGB-D Camera Relocalization via Randomized Ferns for Keyframe Encoding" (TVCG 2015).
//! A fern asks a few yes-or-no questions about an image; two images are the more similar, the more
//! ferns get the same answers to all of theirs. Differs from the paper where measurements on
//! recordings said so (`examples/recall.rs` repeats them):
//!
//! - Colour is compared between two pixels, not with a threshold, so that exposure cancels.
//! - A frame is encoded at many shifts of its image. A camera that has turned is recognised, and
//!   the shift tells how far it has turned.
//! - A fern without depth in one of the two images is judged by colour alone.
//! - What unrelated images agree in by chance is subtracted.
//! - All keyframes are compared one by one, many bytes at a time. At 63 shifts that is no more
//!   work than inverted lists would be, so there are none.
//!
//! ```
//! use fgs_geom::{KeyframeId, RgbdFrame};
//! use fgs_place::{PlaceDescriptor, PlaceIndex};
//!
//! fn remember_and_find(index: &mut PlaceIndex, id: KeyframeId, keyframe: &RgbdFrame, lost: &RgbdFrame) {
//!     index.add(id, &PlaceDescriptor::new(keyframe));
//!     for place in index.most_similar(&PlaceDescriptor::new(lost), 5) {
//!         let guess = place.keyframe_from_frame(&lost.camera);
//!         println!("{:?}: {:.2}, turned by {:.2}", place.id, place.similarity, guess.rotation.angle());
//!     }
//! }
//! ```

mod descriptor;
mod fern;
mod index;
mod small_image;

pub use descriptor::PlaceDescriptor;
pub use index::{PlaceIndex, Similar};
