//! Brightness images and their pyramids, sampled at subpixel positions with exact derivatives.

use fgs_geom::{Camera, Image, Intrinsics, RgbdFrame};

/// Luma weights of ITU-R BT.601.
const LUMA: [f32; 3] = [0.299, 0.587, 0.114];

/// Brightness of an image, 0 to 1, with its camera. Invalid pixels are NaN.
#[derive(Clone, Debug)]
pub struct IntensityImage {
    /// Pinhole camera at this resolution.
    pub camera: Camera,
    pixels: Image<f32>,
}

impl IntensityImage {
    /// Converts the colour image of a frame at full resolution.
    pub fn of_frame(frame: &RgbdFrame) -> Self {
        let pixels = frame.color.map(|rgb| {
            let weighted = rgb
                .iter()
                .zip(LUMA)
                .map(|(c, weight)| f32::from(*c) * weight);
            weighted.sum::<f32>() / 255.0
        });
        Self::masked(frame.camera, pixels, frame.color_valid.as_deref())
    }

    /// Converts a rendered image with colours from 0 to 1. Pixels where `is_seen` is false become
    /// NaN. Both images have the size of the camera.
    pub fn of_render(camera: Camera, color: &Image<[f32; 3]>, is_seen: &Image<bool>) -> Self {
        let pixels = color.map(|rgb| rgb.iter().zip(LUMA).map(|(c, w)| c * w).sum());
        Self::masked(camera, pixels, Some(is_seen))
    }

    /// NaN where `is_seen` is false.
    fn masked(camera: Camera, mut pixels: Image<f32>, is_seen: Option<&Image<bool>>) -> Self {
        let seen = is_seen.into_iter().flat_map(Image::data);
        for (pixel, seen) in pixels.data_mut().iter_mut().zip(seen) {
            if !seen {
                *pixel = f32::NAN;
            }
        }
        Self { camera, pixels }
    }

    /// Halves the resolution by averaging blocks of 2x2 pixels. An odd last row or column is
    /// dropped.
    pub fn halved(&self) -> Self {
        let (width, height) = (self.camera.width / 2, self.camera.height / 2);
        let pixels = Image::from_fn(width, height, |u, v| {
            let at = |du, dv| self.pixels.at(2 * u + du, 2 * v + dv);
            0.25 * (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1))
        });
        let Intrinsics { fx, fy, cx, cy } = self.camera.intrinsics;
        Self {
            camera: Camera {
                width,
                height,
                // The centre of the new pixel 0 lies midway between those of the old pixels 0 and
                // 1.
                intrinsics: Intrinsics {
                    fx: 0.5 * fx,
                    fy: 0.5 * fy,
                    cx: 0.5 * cx - 0.25,
                    cy: 0.5 * cy - 0.25,
                },
            },
            pixels,
        }
    }

    /// The pixels.
    pub fn pixels(&self) -> &Image<f32> {
        &self.pixels
    }

    /// Bilinearly interpolated brightness at (u, v) and its derivatives with respect to u and v,
    /// per pixel. `None` outside the image and where one of the four neighbours is invalid.
    #[inline]
    pub fn sample(&self, u: f64, v: f64) -> Option<[f32; 3]> {
        let (width, height) = (self.camera.width, self.camera.height);
        // Written so that NaN is rejected too.
        let inside = u >= 0.0 && v >= 0.0 && u < width as f64 - 1.0 && v < height as f64 - 1.0;
        if !inside {
            return None;
        }
        let (column, row) = (u as usize, v as usize);
        let (a, b) = ((u - column as f64) as f32, (v - row as f64) as f32);
        let upper = &self.pixels.data()[row * width + column..][..2];
        let lower = &self.pixels.data()[(row + 1) * width + column..][..2];
        let top = upper[0] + a * (upper[1] - upper[0]);
        let bottom = lower[0] + a * (lower[1] - lower[0]);
        let along_u = (1.0 - b) * (upper[1] - upper[0]) + b * (lower[1] - lower[0]);
        let value = top + b * (bottom - top);
        (value.is_finite()).then_some([value, along_u, bottom - top])
    }
}

/// Image pyramid: brightness at full, half, quarter, ... resolution.
#[derive(Clone, Debug)]
pub struct IntensityPyramid {
    /// The images, finest first.
    pub levels: Vec<IntensityImage>,
}

impl IntensityPyramid {
    /// `count` levels of the colour image of a frame, the finest at full resolution. There are
    /// fewer levels if the image would become smaller than 8 pixels.
    pub fn of_frame(frame: &RgbdFrame, count: usize) -> Self {
        Self::new(IntensityImage::of_frame(frame), count)
    }

    /// A pyramid of `count` levels on top of any image; fewer for small images, as in
    /// [`Self::of_frame`].
    pub fn new(finest: IntensityImage, count: usize) -> Self {
        let mut levels = vec![finest];
        while levels.len() < count {
            let last = &levels[levels.len() - 1];
            if last.camera.width.min(last.camera.height) < 16 {
                break;
            }
            levels.push(last.halved());
        }
        Self { levels }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use fgs_geom::FrameIndex;

    use super::*;

    fn frame(width: usize, height: usize) -> RgbdFrame {
        let intrinsics = Intrinsics {
            fx: 30.0,
            fy: 31.0,
            cx: 0.5 * width as f64,
            cy: 0.5 * height as f64,
        };
        let camera = Camera::new(width, height, intrinsics).unwrap();
        let color = Image::from_fn(width, height, |u, v| [(5 * u) as u8, (3 * v) as u8, 7]);
        let depth = Image::filled(width, height, 1.0);
        RgbdFrame::new(FrameIndex(0), 0.0, color, depth, camera).unwrap()
    }

    #[test]
    fn a_linear_image_is_sampled_exactly_at_every_level() {
        let pyramid = IntensityPyramid::of_frame(&frame(40, 32), 2);
        let truth = |u: f64, v: f64| (0.299 * 5.0 * u + 0.587 * 3.0 * v + 0.114 * 7.0) / 255.0;
        for (level, image) in pyramid.levels.iter().enumerate() {
            let size = f64::from(1 << level);
            for (u, v) in [(0.0, 0.0), (3.3, 4.6), (17.9, 14.2)] {
                let [value, du, dv] = image.sample(u, v).unwrap();
                let full = |x: f64| (x + 0.5) * size - 0.5;
                assert!((f64::from(value) - truth(full(u), full(v))).abs() <= 1e-6);
                assert!((f64::from(du) - size * 0.299 * 5.0 / 255.0).abs() <= 1e-6);
                assert!((f64::from(dv) - size * 0.587 * 3.0 / 255.0).abs() <= 1e-6);
            }
        }
        // A point projects to the same place at both resolutions.
        let [fine, coarse] = [0, 1].map(|i| pyramid.levels[i].camera);
        let point = fine.unproject(12.0, 21.0, 2.0);
        let pixel = coarse.project(&point).unwrap();
        assert!((pixel.x - (12.5 / 2.0 - 0.5)).abs() <= 1e-12);
        assert!((pixel.y - (21.5 / 2.0 - 0.5)).abs() <= 1e-12);
    }

    #[test]
    fn what_was_not_seen_or_lies_outside_has_no_brightness() {
        let mut frame = frame(40, 32);
        frame.color_valid = Some(Arc::new(Image::from_fn(40, 32, |u, v| (u, v) != (10, 10))));
        let pyramid = IntensityPyramid::of_frame(&frame, 2);
        let [fine, coarse] = [&pyramid.levels[0], &pyramid.levels[1]];
        assert!(fine.sample(9.5, 10.0).is_none() && fine.sample(10.0, 9.5).is_none());
        assert!(fine.sample(11.5, 10.0).is_some());
        assert!(coarse.sample(5.2, 5.2).is_none() && coarse.sample(6.2, 6.2).is_some());
        for (u, v) in [
            (-0.1, 5.0),
            (39.0, 5.0),
            (5.0, 31.0),
            (f64::NAN, 5.0),
            (1e300, 5.0),
        ] {
            assert!(fine.sample(u, v).is_none(), "({u}, {v})");
        }
    }

    #[test]
    fn small_images_have_fewer_levels() {
        assert_eq!(
            IntensityPyramid::of_frame(&frame(40, 32), 9).levels.len(),
            3
        );
        assert_eq!(IntensityPyramid::of_frame(&frame(3, 2), 4).levels.len(), 1);
    }
}
