//! Changes of a frame that must not matter.

use fgs_geom::{Image, RgbdFrame};

#[derive(Clone, Copy, Debug)]
pub enum Change {
    Nothing,
    Darker,
    Brighter,
    Offset,
    MotionBlur,
    NoDepth,
}

impl Change {
    pub const ALL: [Self; 6] = [
        Self::Nothing,
        Self::Darker,
        Self::Brighter,
        Self::Offset,
        Self::MotionBlur,
        Self::NoDepth,
    ];

    pub fn of(self, frame: &RgbdFrame) -> RgbdFrame {
        let mut frame = frame.clone();
        let exposed = |gain: f32, offset: f32| {
            (frame.color).map(|rgb| rgb.map(|c| (gain * f32::from(c) + offset) as u8))
        };
        match self {
            Self::Nothing => {}
            Self::Darker => frame.color = exposed(0.6, 0.0),
            Self::Brighter => frame.color = exposed(1.5, 0.0),
            Self::Offset => frame.color = exposed(1.0, 30.0),
            Self::MotionBlur => frame.color = blurred(&frame.color),
            Self::NoDepth => frame.depth_m.data_mut().fill(0.0),
        }
        frame
    }
}

/// The mean along a twentieth of the image's width.
fn blurred(color: &Image<[u8; 3]>) -> Image<[u8; 3]> {
    let length = color.width() / 20;
    Image::from_fn(color.width(), color.height(), |u, v| {
        let end = (u + length).min(color.width());
        let pixels = &color.row(v)[u..end];
        std::array::from_fn(|channel| {
            let sum: usize = pixels.iter().map(|rgb| usize::from(rgb[channel])).sum();
            (sum / pixels.len().max(1)) as u8
        })
    })
}
