//! The features of a frame: corners with their descriptors and places in space.

use std::cmp::Reverse;

use fgs_geom::{Camera, Image, RgbdFrame, has_depth};
use nalgebra::{Vector2, Vector3};

use crate::corners::{BORDER, Corner, corners};
use crate::descriptor::{Descriptor, describe, smoothed};
use crate::pyramid::{Level, pyramid};

/// Features of a frame at most.
const MAX_FEATURES: usize = 1000;

/// Depth is taken from this many columns and rows on each side of a corner.
const DEPTH_RADIUS: usize = 2;

/// Depths that differ by more than this share are those of two surfaces.
const MAX_DEPTH_CHANGE: f32 = 0.1;

/// A corner of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Feature {
    /// Where it is in the colour image.
    pub pixel: Vector2<f64>,
    /// The width of a pixel of the image in which it was found, pixels of the frame. What is
    /// unsharp is found where pixels are large.
    pub scale: f64,
    /// What is around it.
    pub descriptor: Descriptor,
    /// Where it is in the camera's axes, metres; `None` where no depth was measured.
    pub point: Option<Vector3<f64>>,
}

/// The features of a frame.
#[derive(Clone, Debug)]
pub struct Features {
    /// The frame's camera.
    pub camera: Camera,
    /// The features, at most 1000.
    pub all: Vec<Feature>,
}

impl Features {
    /// The features of a frame. Parts that the colour camera did not see give none.
    pub fn detect(frame: &RgbdFrame) -> Self {
        let unseen = Unseen::of(frame);
        let levels = pyramid(frame, 2 * BORDER + 1);
        let mut found: Vec<(&Level, Corner)> = Vec::new();
        for level in &levels {
            let seen = corners(&level.pixels)
                .into_iter()
                .filter(|corner| unseen.is_clear(corner, level.scale));
            found.extend(seen.map(|corner| (level, corner)));
        }
        // Of all cells the best, then of all cells the second, ...: they are spread over the image.
        found.sort_by(|(_, a), (_, b)| a.rank.cmp(&b.rank).then(b.score.total_cmp(&a.score)));
        found.truncate(MAX_FEATURES);
        found.sort_by_key(|(level, corner)| (Reverse(level.pixels.width()), corner.v, corner.u));
        let mut all = Vec::with_capacity(found.len());
        for of_level in found.chunk_by(|(a, _), (b, _)| std::ptr::eq(*a, *b)) {
            let image = &of_level[0].0.pixels;
            let scale = of_level[0].0.scale;
            let smooth = smoothed(image);
            all.extend(of_level.iter().map(|(_, corner)| {
                let center = |i: usize| (i as f64 + 0.5) * scale - 0.5;
                let pixel = Vector2::new(center(corner.u), center(corner.v));
                Feature {
                    pixel,
                    scale,
                    descriptor: describe(image, &smooth, corner.u, corner.v),
                    point: depth_at(&frame.depth_m, &pixel)
                        .map(|depth_m| frame.camera.unproject(pixel.x, pixel.y, depth_m)),
                }
            }));
        }
        Self {
            camera: frame.camera,
            all,
        }
    }
}

/// The median of the depths measured near a pixel; `None` where there is none or they disagree.
fn depth_at(depth_m: &Image<f32>, pixel: &Vector2<f64>) -> Option<f64> {
    let (u, v) = (pixel.x.round() as usize, pixel.y.round() as usize);
    let columns = u.saturating_sub(DEPTH_RADIUS)..(u + DEPTH_RADIUS + 1).min(depth_m.width());
    let rows = v.saturating_sub(DEPTH_RADIUS)..(v + DEPTH_RADIUS + 1).min(depth_m.height());
    let mut near: Vec<f32> = rows
        .flat_map(|row| depth_m.row(row)[columns.clone()].iter().copied())
        .filter(|depth| has_depth(*depth))
        .collect();
    near.sort_by(f32::total_cmp);
    let (nearest, farthest) = (*near.first()?, *near.last()?);
    if farthest - nearest > MAX_DEPTH_CHANGE * nearest {
        return None;
    }
    Some(f64::from(near[near.len() / 2]))
}

/// Counts of the pixels that the colour camera did not see, above and left of each pixel.
struct Unseen(Option<Image<u32>>);

impl Unseen {
    fn of(frame: &RgbdFrame) -> Self {
        let Some(valid) = frame.color_valid.as_deref() else {
            return Self(None);
        };
        let (width, height) = (valid.width(), valid.height());
        let mut counts = Image::filled(width + 1, height + 1, 0);
        for v in 0..height {
            let mut in_row = 0;
            for (u, seen) in valid.row(v).iter().enumerate() {
                in_row += u32::from(!seen);
                counts.set(u + 1, v + 1, counts.at(u + 1, v) + in_row);
            }
        }
        Self(Some(counts))
    }

    /// Whether the camera saw all of the patch around a corner found at pixels of width `scale`.
    fn is_clear(&self, corner: &Corner, scale: f64) -> bool {
        let Some(counts) = &self.0 else {
            return true;
        };
        let ends = |center: usize, size: usize| {
            let first = (center - BORDER) as f64 * scale;
            let end = ((center + BORDER + 1) as f64 * scale).ceil() as usize;
            (first as usize, end.min(size))
        };
        let (left, right) = ends(corner.u, counts.width() - 1);
        let (top, bottom) = ends(corner.v, counts.height() - 1);
        counts.at(right, bottom) + counts.at(left, top)
            == counts.at(left, bottom) + counts.at(right, top)
    }
}
