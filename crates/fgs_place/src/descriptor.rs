//! What a frame shows, in a form that can be compared with others.

use fgs_geom::RgbdFrame;

use crate::fern::{Codes, codes};
use crate::small_image::{HEIGHT, WIDTH, small_image};

/// Largest shift of an image against a keyframe, cells. With a Kinect's field of view 12 and 9
/// degrees; larger ones find little more and prefer places that overlap less.
const MAX_SHIFT: [i32; 2] = [4, 3];

/// What a frame shows; its size does not depend on the frame's. A frame of 640x480 takes about
/// 0.5 ms, most of it for averages of pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaceDescriptor {
    /// As the frame is.
    pub(crate) unmoved: Codes,
    /// The frame's content moved by cells, `MAX_SHIFT` at most.
    pub(crate) moved: Vec<Moved>,
}

/// A frame's content moved so that a shift against a keyframe is undone.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Moved {
    /// The shift that it undoes, in widths and heights of the image.
    pub shift: [f64; 2],
    pub codes: Codes,
}

impl PlaceDescriptor {
    /// Describes a frame of any size.
    pub fn new(frame: &RgbdFrame) -> Self {
        let image = small_image(frame);
        let [right, down] = MAX_SHIFT;
        let shifts = (-down..=down).flat_map(|v| (-right..=right).map(move |u| [u, v]));
        Self {
            unmoved: codes(&image, [0, 0]),
            moved: shifts
                .map(|shift| Moved {
                    shift: [
                        shift[0] as f64 / WIDTH as f64,
                        shift[1] as f64 / HEIGHT as f64,
                    ],
                    codes: codes(&image, shift),
                })
                .collect(),
        }
    }
}
