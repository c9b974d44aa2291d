//! Resampling: an image made of another, each pixel taken from somewhere else in it.

use crate::Image;

/// For each pixel of an image, its source coordinates (u, v) in another image of the same size.
#[derive(Clone, Debug)]
pub struct PixelMap {
    source: Image<[f32; 2]>,
}

impl PixelMap {
    /// From the source coordinates, pixels.
    pub fn new(source: Image<[f32; 2]>) -> Self {
        Self { source }
    }

    /// The colour image's resampling, bilinear; black where [`Self::color_valid`] is false. `None` if
    /// the image has another size than the map.
    pub fn color(&self, image: &Image<[u8; 3]>) -> Option<Image<[u8; 3]>> {
        self.fits(image).then(|| {
            self.source
                .map(|&[x, y]| bilinear(image, x, y).unwrap_or_default())
        })
    }

    /// Which pixels of [`Self::color`] the camera saw: those whose source lies between the centres
    /// of the image's outermost pixels, so that all four neighbours exist.
    pub fn color_valid(&self) -> Image<bool> {
        self.source
            .map(|&[x, y]| corners(&self.source, x, y).is_some())
    }

    /// The depth image's resampling, each pixel the nearest of the image (interpolation would invent
    /// surfaces across edges); 0 where it shows nothing. `None` if the image has another size than
    /// the map.
    pub fn depth(&self, image: &Image<f32>) -> Option<Image<f32>> {
        self.fits(image).then(|| {
            self.source
                .map(|&[x, y]| nearest(image, x, y).unwrap_or(0.0))
        })
    }

    fn fits<T>(&self, image: &Image<T>) -> bool {
        (image.width(), image.height()) == (self.source.width(), self.source.height())
    }
}

/// The places in an image's data of the four pixels around a point, and the point's way from the first to
/// the others, 0 to 1 to the right and down. `None` outside the centres of the outermost pixels.
#[inline(always)]
pub(crate) fn corners<T>(image: &Image<T>, x: f32, y: f32) -> Option<([usize; 4], [f32; 2])> {
    let (width, height) = (image.width(), image.height());
    // Without a pixel the range is empty.
    let inside = |x: f32, size: usize| x >= 0.0 && x <= size as f32 - 1.0;
    (inside(x, width) && inside(y, height)).then(|| {
        // By way of i32, which processors convert to in one step.
        let (u, v) = (x as i32 as usize, y as i32 as usize);
        // In the last column the way is 0, so any neighbour will do; the same for rows.
        let first = v * width + u;
        let aside = usize::from(u + 1 < width);
        let below = first + if v + 1 < height { width } else { 0 };
        let ways = [x - u as f32, y - v as f32];
        ([first, first + aside, below, below + aside], ways)
    })
}

/// The colour at a point of an image; `None` outside it.
#[inline(always)]
pub(crate) fn bilinear(image: &Image<[u8; 3]>, x: f32, y: f32) -> Option<[u8; 3]> {
    let (places, [a, b]) = corners(image, x, y)?;
    let weights = [(1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b];
    let pixels = image.data();
    let mut sum = [0.5; 3];
    for (place, weight) in places.into_iter().zip(weights) {
        for (sum, value) in sum.iter_mut().zip(pixels[place]) {
            *sum += weight * f32::from(value);
        }
    }
    // Rounds: the cast cuts off.
    Some(sum.map(|value| value as i32 as u8))
}

fn nearest<T: Copy>(image: &Image<T>, x: f32, y: f32) -> Option<T> {
    let (u, v) = (x + 0.5, y + 0.5);
    (u >= 0.0 && v >= 0.0)
        .then(|| image.get(u as usize, v as usize))
        .flatten()
}
