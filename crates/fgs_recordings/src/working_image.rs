//! Colour and depth of different sizes, brought to one camera.
//!
//! A phone gives colour of 1920x1440 and depth of 256x192 pixels. Colour is reduced by a whole number, so
//! that each new pixel is the mean of the same number of old ones, and depth is brought to that size
//! (`depth_upsampling`). Where both have one size already, nothing is changed.
//!
//! Pixel centres lie at integers, so an image begins at -0.5: at n times the size, u becomes
//! n (u + 0.5) - 0.5.

use fgs_data::FrameImages;
use fgs_geom::{Camera, Image, Intrinsics, PixelMap};

use crate::depth_upsampling::{Axis, upsampled};

/// The most pixels of a reduced colour image, those of Replica's images: with more, a frame takes longer
/// than it tells, since depth knows a twentieth of them at best.
const MAX_PIXELS: usize = 820_000;

/// Fields of view that differ by more are not of the same picture.
const MAX_ASPECT_ERROR: f64 = 0.02;

/// Intrinsics that move no pixel by more than this, in pixels, are the same: resampling blurs.
const MAX_SHIFT: f64 = 0.25;

/// How a recording's images become frames of one camera.
pub(crate) struct WorkingImage {
    color_size: (usize, usize),
    depth_size: (usize, usize),
    reduction: usize,
    camera: Camera,
}

impl WorkingImage {
    /// For colour images of `native` and depth images that show the same field of view.
    ///
    /// # Errors
    /// In plain words, if they cannot.
    pub fn new(native: &Camera, depth_size: (usize, usize)) -> Result<Self, String> {
        let (width, height) = (native.width, native.height);
        let color_size = (width, height);
        let (depth_width, depth_height) = depth_size;
        if depth_width == 0 || depth_height == 0 {
            return Err("depth has no pixel".into());
        }
        let scale_x = depth_width as f64 / width as f64;
        let scale_y = depth_height as f64 / height as f64;
        if (scale_x / scale_y - 1.0).abs() > MAX_ASPECT_ERROR {
            return Err(format!(
                "depth of {depth_width}x{depth_height} pixels does not show what colour of \
                 {width}x{height} shows"
            ));
        }
        let fits = |n: &usize| (width / n) * (height / n) <= MAX_PIXELS;
        let reduction = if color_size == depth_size {
            1
        } else {
            (1..).find(fits).unwrap_or(1)
        };
        let intrinsics = reduced(&native.intrinsics, reduction);
        let camera = Camera::new(width / reduction, height / reduction, intrinsics)
            .map_err(|error| error.to_string())?;
        Ok(Self {
            color_size,
            depth_size,
            reduction,
            camera,
        })
    }

    /// The camera of all frames.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Columns and rows of colour as it comes.
    pub fn color_size(&self) -> (usize, usize) {
        self.color_size
    }

    /// Columns and rows of depth as it comes, metres.
    pub fn depth_size(&self) -> (usize, usize) {
        self.depth_size
    }

    /// A frame's images. `own` are the intrinsics of its colour image as it comes, where they differ from
    /// frame to frame: a phone's lens moves when it focuses.
    pub fn images(
        &self,
        color: &Image<[u8; 3]>,
        depth_m: &Image<f32>,
        own: Option<&Intrinsics>,
    ) -> FrameImages {
        let color = reduced_color(color, self.reduction);
        let own = own
            .map(|own| reduced(own, self.reduction))
            .filter(|own| self.largest_shift(own) > MAX_SHIFT);
        let Some(own) = own else {
            return FrameImages {
                color,
                depth_m: self.depth(depth_m, &self.camera.intrinsics),
                color_valid: None,
            };
        };
        let [x, y] = axes(&self.camera.intrinsics, &own);
        let map = PixelMap::new(Image::from_fn(
            self.camera.width,
            self.camera.height,
            |u, v| [x.at(u as f64) as f32, y.at(v as f64) as f32],
        ));
        FrameImages {
            color_valid: Some(map.color_valid()),
            depth_m: self.depth(depth_m, &own),
            // The map is made for this size.
            color: map.color(&color).unwrap_or(color),
        }
    }

    /// Depth in the working image, whose pixels lie in the frame's own image by its intrinsics `own`.
    fn depth(&self, depth_m: &Image<f32>, own: &Intrinsics) -> Image<f32> {
        let [x, y] = axes(&self.camera.intrinsics, own);
        let n = self.reduction as f64;
        let scale_x = n * self.depth_size.0 as f64 / self.color_size.0 as f64;
        let scale_y = n * self.depth_size.1 as f64 / self.color_size.1 as f64;
        let size = (self.camera.width, self.camera.height);
        upsampled(depth_m, size, [x.scaled(scale_x), y.scaled(scale_y)])
    }

    /// How far apart the two cameras see a thing at most, pixels: at a corner.
    fn largest_shift(&self, own: &Intrinsics) -> f64 {
        let [x, y] = axes(&self.camera.intrinsics, own);
        let shift = |axis: Axis, at: f64| (axis.at(at) - at).abs();
        let (right, bottom) = (self.camera.width as f64, self.camera.height as f64);
        let shifts = [
            shift(x, 0.0),
            shift(x, right),
            shift(y, 0.0),
            shift(y, bottom),
        ];
        shifts.into_iter().fold(0.0, f64::max)
    }
}

/// Where a pixel of a camera lies in the image of another that looks the same way.
fn axes(from: &Intrinsics, to: &Intrinsics) -> [Axis; 2] {
    [
        Axis::between((from.fx, from.cx), (to.fx, to.cx)),
        Axis::between((from.fy, from.cy), (to.fy, to.cy)),
    ]
}

fn reduced(k: &Intrinsics, n: usize) -> Intrinsics {
    let n = n as f64;
    Intrinsics {
        fx: k.fx / n,
        fy: k.fy / n,
        cx: (k.cx + 0.5) / n - 0.5,
        cy: (k.cy + 0.5) / n - 0.5,
    }
}

/// Each pixel the mean of n x n; what is left over at the right and below is cut off.
fn reduced_color(image: &Image<[u8; 3]>, n: usize) -> Image<[u8; 3]> {
    if n == 1 {
        return image.clone();
    }
    let count = (n * n) as u32;
    Image::from_fn(image.width() / n, image.height() / n, |u, v| {
        let mut sum = [count / 2; 3];
        for row in n * v..n * (v + 1) {
            for pixel in &image.row(row)[n * u..n * (u + 1)] {
                for (sum, value) in sum.iter_mut().zip(pixel) {
                    *sum += u32::from(*value);
                }
            }
        }
        sum.map(|sum| (sum / count) as u8)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn intrinsics(f: f64, cx: f64, cy: f64) -> Intrinsics {
        Intrinsics {
            fx: f,
            fy: f,
            cx,
            cy,
        }
    }

    fn phone() -> Camera {
        Camera::new(1920, 1440, intrinsics(1600.0, 955.5, 727.5)).unwrap()
    }

    #[test]
    fn a_phones_images_are_reduced_by_a_whole_number() {
        let working = WorkingImage::new(&phone(), (256, 192)).unwrap();
        let camera = working.camera();
        assert_eq!((camera.width, camera.height), (960, 720));
        // A ray through the same place of the picture.
        assert_eq!(camera.intrinsics, intrinsics(800.0, 477.5, 363.5));
    }

    #[test]
    fn equal_sizes_are_left_alone() {
        let camera = Camera::new(1920, 1440, intrinsics(1600.0, 955.5, 727.5)).unwrap();
        let working = WorkingImage::new(&camera, (1920, 1440)).unwrap();
        assert_eq!(*working.camera(), camera);
        let small = Camera::new(64, 48, intrinsics(64.0, 31.5, 23.5)).unwrap();
        let working = WorkingImage::new(&small, (64, 48)).unwrap();
        let color = Image::from_fn(64, 48, |u, v| [u as u8, v as u8, (u * v) as u8]);
        let depth = Image::from_fn(64, 48, |u, v| 0.001 * (1 + (7 * u + 31 * v) % 977) as f32);
        let images = working.images(&color, &depth, Some(&small.intrinsics));
        assert_eq!(images.color.data(), color.data());
        assert_eq!(images.depth_m.data(), depth.data());
        assert!(images.color_valid.is_none());
    }

    #[test]
    fn a_turned_depth_image_is_refused() {
        assert!(WorkingImage::new(&phone(), (192, 256)).is_err());
    }

    #[test]
    fn colours_are_means() {
        let image = Image::from_fn(5, 4, |u, v| [u as u8 * 10, v as u8, 255]);
        let half = reduced_color(&image, 2);
        assert_eq!((half.width(), half.height()), (2, 2));
        // Rounded up at a half.
        assert_eq!(half.at(1, 1), [25, 3, 255]);
    }

    /// A frame taken with another focal length shows the same as the others afterwards.
    #[test]
    fn a_lens_that_moved_is_brought_to_the_common_camera() {
        let camera = Camera::new(64, 48, intrinsics(64.0, 31.5, 23.5)).unwrap();
        let working = WorkingImage::new(&camera, (32, 24)).unwrap();
        // A slanted plane, painted by the ray that a pixel looks along.
        let shade = |x: f64| (128.0 + 100.0 * (6.0 * x).sin()) as u8;
        let paint =
            |k: &Intrinsics| Image::from_fn(64, 48, |u, _| [shade((u as f64 - k.cx) / k.fx); 3]);
        let plane = |k: &Intrinsics| {
            let (cx, f) = ((k.cx + 0.5) / 2.0 - 0.5, k.fx / 2.0);
            Image::from_fn(32, 24, |u, _| {
                1.0 / (0.5 + 0.1 * (u as f64 - cx) / f) as f32
            })
        };
        let own = intrinsics(68.0, 33.0, 22.5);
        let usual = working.images(&paint(&camera.intrinsics), &plane(&camera.intrinsics), None);
        let moved = working.images(&paint(&own), &plane(&own), Some(&own));
        let valid = moved.color_valid.unwrap();
        assert!(valid.data().iter().filter(|valid| **valid).count() > 2500);
        for v in 4..44 {
            for u in 4..60 {
                let (a, b) = (usual.color.at(u, v)[0], moved.color.at(u, v)[0]);
                assert!(valid.at(u, v) && a.abs_diff(b) <= 2, "{u} {v}: {a} {b}");
                let (a, b) = (usual.depth_m.at(u, v), moved.depth_m.at(u, v));
                assert!((a - b).abs() < 1e-5, "{u} {v}: {a} {b}");
            }
        }
    }
}
