//! Small pictures for a page.

use fgs_geom::{Camera, Image, RgbdFrame, View, has_depth};
use fgs_splat::{Gaussians, Rasterizer, Rendered};
use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;
use image::imageops::thumbnail;

/// Enough to see what is going on, and a render of it takes little time.
const MAX_WIDTH: usize = 320;
const JPEG_QUALITY: u8 = 82;

/// Depth from near to far: light to dark, as in the dark one looks far; equal steps of depth look like equal
/// steps of colour.
const NEAR_TO_FAR: [[f32; 3]; 6] = [
    [252.0, 236.0, 160.0],
    [246.0, 170.0, 92.0],
    [222.0, 97.0, 84.0],
    [150.0, 54.0, 112.0],
    [78.0, 32.0, 108.0],
    [20.0, 14.0, 48.0],
];
/// Where there is no depth.
const NO_DEPTH: [u8; 3] = [16, 19, 26];
/// Where an image has detail.
const DETAIL: [f32; 3] = [255.0, 176.0, 32.0];
/// Where the map lacks gaussians.
const MISSING: [f32; 3] = [56.0, 152.0, 255.0];

/// The size of a camera's pictures.
pub fn small(camera: &Camera) -> Camera {
    let width = camera.width.min(MAX_WIDTH);
    let height = (camera.height * width).div_ceil(camera.width).max(1);
    // A principal point in the image stays there.
    camera.resized(width, height).unwrap_or(*camera)
}

/// An image at the size of a small camera.
pub fn color(image: &Image<[u8; 3]>, size: &Camera) -> RgbImage {
    thumbnail(&rgb(image), side(size.width), side(size.height))
}

/// A render as it is shown.
pub fn rendered_color(rendered: &Rendered) -> RgbImage {
    rgb(&rendered.color_bytes())
}

/// What a map looks like from somewhere.
pub fn render(gaussians: &Gaussians, view: &View) -> Rendered {
    Rasterizer::default()
        .render(gaussians, view)
        .rendered()
        .clone()
}

/// The depth of a frame, every so many pixels one.
pub fn small_depth(depth_m: &Image<f32>, size: &Camera) -> Image<f32> {
    Image::from_fn(size.width, size.height, |u, v| {
        let (u, v) = source(u, v, size, depth_m.width(), depth_m.height());
        depth_m.at(u, v)
    })
}

/// The depth that a render shows, where it is opaque.
pub fn rendered_depth(rendered: &Rendered) -> Image<f32> {
    Image::from_fn(rendered.alpha.width(), rendered.alpha.height(), |u, v| {
        if rendered.alpha.at(u, v) > 0.5 {
            rendered.surface_depth_m(u, v)
        } else {
            0.0
        }
    })
}

/// The nearest and the farthest depth, but for a fiftieth; metres.
pub fn depth_range(depth_m: &Image<f32>) -> [f32; 2] {
    let mut depths: Vec<f32> = depth_m
        .data()
        .iter()
        .copied()
        .filter(|d| has_depth(*d))
        .collect();
    depths.sort_unstable_by(f32::total_cmp);
    match depths.len() {
        0 => [0.0, 1.0],
        len => [depths[len / 50], depths[len - 1 - len / 50]],
    }
}

/// Depth as colours, over a range in metres.
pub fn depth_colors(depth_m: &Image<f32>, [near, far]: [f32; 2]) -> RgbImage {
    let color = |depth: &f32| {
        if !has_depth(*depth) {
            return NO_DEPTH;
        }
        let place = ((depth - near) / (far - near).max(1e-3)).clamp(0.0, 1.0);
        let place = place * (NEAR_TO_FAR.len() - 1) as f32;
        let from = (place as usize).min(NEAR_TO_FAR.len() - 2);
        let share = place - from as f32;
        std::array::from_fn(|i| {
            let [a, b] = [NEAR_TO_FAR[from][i], NEAR_TO_FAR[from + 1][i]];
            (a + share * (b - a)) as u8
        })
    };
    rgb(&depth_m.map(color))
}

/// A frame, dark, with what a keyframe gives to the map.
pub fn addition(
    photograph: &Image<[u8; 3]>,
    detail: &Image<bool>,
    missing: &Image<bool>,
    size: &Camera,
) -> RgbImage {
    let mut picture = color(photograph, size);
    for (u, v, pixel) in picture.enumerate_pixels_mut() {
        let (u, v) = (u as usize, v as usize);
        let [from, to] = [(u, v), (u + 1, v + 1)]
            .map(|(u, v)| source(u, v, size, detail.width(), detail.height()));
        let share = |mask: &Image<bool>| {
            let pixels = (from.1..=to.1).flat_map(|v| (from.0..=to.0).map(move |u| (u, v)));
            let count = pixels.clone().count().max(1);
            pixels
                .filter(|(u, v)| mask.get(*u, *v) == Some(true))
                .count() as f32
                / count as f32
        };
        let gray = 0.4 * pixel.0.iter().map(|c| f32::from(*c) / 3.0).sum::<f32>();
        let (missing, detail) = (0.5 * share(missing), share(detail));
        for i in 0..3 {
            let ground = gray + missing * (MISSING[i] - gray);
            pixel.0[i] = (ground + detail * (DETAIL[i] - ground)) as u8;
        }
    }
    picture
}

/// Share of a mask that is set.
pub fn share(mask: &Image<bool>) -> f64 {
    let set = mask.data().iter().filter(|set| **set).count();
    set as f64 / mask.data().len() as f64
}

/// Peak signal-to-noise ratio of a render against a photograph where a camera saw something, dB.
pub fn psnr_db(frame: &RgbdFrame, photograph: &RgbImage, shown: &RgbImage, size: &Camera) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for ((u, v, a), b) in photograph.enumerate_pixels().zip(shown.pixels()) {
        let (u, v) = (u as usize, v as usize);
        let (u, v) = source(u, v, size, frame.color.width(), frame.color.height());
        if frame.has_color(u, v) {
            for i in 0..3 {
                sum += ((f64::from(a.0[i]) - f64::from(b.0[i])) / 255.0).powi(2);
                count += 1.0;
            }
        }
    }
    // No rounded picture is better than this.
    -10.0 * (sum / f64::max(count, 1.0)).max(1e-6).log10()
}

/// The bytes of a JPEG file.
pub fn jpeg(picture: &RgbImage) -> Vec<u8> {
    let mut bytes = Vec::new();
    // Into memory, with sides of less than 65536 pixels: it does not fail.
    let _ = JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY).encode_image(picture);
    bytes
}

/// The pixel of an image that a pixel of a small one stands for.
fn source(u: usize, v: usize, size: &Camera, width: usize, height: usize) -> (usize, usize) {
    let place = |x: usize, size: usize, full: usize| (x * full / size).min(full - 1);
    (place(u, size.width, width), place(v, size.height, height))
}

fn rgb(image: &Image<[u8; 3]>) -> RgbImage {
    let bytes = image.data().as_flattened().to_vec();
    // An image has all of its pixels.
    RgbImage::from_raw(side(image.width()), side(image.height()), bytes).unwrap_or_default()
}

/// Sides are of cameras, of 65536 pixels at most.
fn side(pixels: usize) -> u32 {
    u32::try_from(pixels).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use fgs_geom::{FrameIndex, Intrinsics};

    use super::*;

    fn camera(width: usize, height: usize) -> Camera {
        let side = width.max(height) as f64;
        let (cx, cy) = (width as f64 / 2.0, height as f64 / 2.0);
        Camera::new(
            width,
            height,
            Intrinsics {
                fx: side,
                fy: side,
                cx,
                cy,
            },
        )
        .unwrap()
    }

    #[test]
    fn depth_has_a_colour_for_near_far_and_none() {
        let depth_m = Image::new(4, 1, vec![1.0, 3.0, 0.0, f32::NAN]).unwrap();
        let picture = depth_colors(&depth_m, [1.0, 3.0]);
        let pixel = |u| picture.get_pixel(u, 0).0;
        assert_eq!(pixel(0), NEAR_TO_FAR[0].map(|c| c as u8));
        assert_eq!(pixel(1), NEAR_TO_FAR[5].map(|c| c as u8));
        assert_eq!((pixel(2), pixel(3)), (NO_DEPTH, NO_DEPTH));
        assert_eq!(depth_range(&depth_m), [1.0, 3.0]);
        assert_eq!(depth_range(&Image::filled(2, 2, 0.0)), [0.0, 1.0]);
    }

    #[test]
    fn masks_are_seen_where_they_are() {
        let size = small(&camera(640, 480));
        assert_eq!((size.width, size.height), (320, 240));
        let photograph = Image::filled(640, 480, [100; 3]);
        let detail = Image::from_fn(640, 480, |u, _| u >= 320);
        let missing = Image::from_fn(640, 480, |_, v| v >= 240);
        let picture = addition(&photograph, &detail, &missing, &size);
        let pixel = |u, v| picture.get_pixel(u, v).0;
        assert_eq!(pixel(10, 10), [40; 3]);
        assert_eq!(pixel(300, 10), DETAIL.map(|c| c as u8));
        assert!(pixel(10, 200)[2] > pixel(10, 200)[0] + 50);
        assert_eq!((share(&detail), share(&missing)), (0.5, 0.5));
    }

    #[test]
    fn what_no_camera_saw_is_not_judged() {
        let camera = camera(8, 8);
        let frame = RgbdFrame::new(
            FrameIndex(0),
            0.0,
            Image::filled(8, 8, [100; 3]),
            Image::filled(8, 8, 1.0),
            camera,
        );
        let valid = Image::from_fn(8, 8, |u, _| u < 4);
        let frame = frame.unwrap().with_color_valid(valid.into()).unwrap();
        let photograph = color(&frame.color, &camera);
        let mut shown = photograph.clone();
        shown.get_pixel_mut(6, 3).0 = [255; 3];
        assert_eq!(psnr_db(&frame, &photograph, &shown, &camera), 60.0);
        shown.get_pixel_mut(1, 3).0 = [151, 100, 100];
        // One of 96 values is off by a fifth.
        let expected = -10.0 * (0.04_f64 / 96.0).log10();
        assert!((psnr_db(&frame, &photograph, &shown, &camera) - expected).abs() < 1e-9);
        assert!(jpeg(&shown).starts_with(&[0xff, 0xd8]));
    }
}
