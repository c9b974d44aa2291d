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
        let (right, bottom) = (
            image.width().checked_sub(1)?,
            image.height().checked_sub(1)?,
        );
        self.fits(image).then(|| {
            self.source.map(|&[x, y]| {
                if !self.has_color(x, y) {
                    return [0; 3];
                }
                let (u, v) = (x as usize, y as usize);
                let (a, b) = (x - u as f32, y - v as f32);
                // In the last column a is 0, so any neighbour will do; the same for rows.
                let (next_u, next_v) = ((u + 1).min(right), (v + 1).min(bottom));
                let (top, below) = (image.row(v), image.row(next_v));
                std::array::from_fn(|i| {
                    let mix = |p: u8, q: u8, t: f32| (1.0 - t) * f32::from(p) + t * f32::from(q);
                    let upper = mix(top[u][i], top[next_u][i], a);
                    let lower = mix(below[u][i], below[next_u][i], a);
                    // Rounds: the cast cuts off. (`round` is a slow call on plain x86-64.)
                    ((1.0 - b) * upper + b * lower + 0.5) as u8
                })
            })
        })
    }

    /// Which pixels of [`Self::color`] the camera saw: those whose source lies between the centres
    /// of the image's outermost pixels, so that all four neighbours exist.
    pub fn color_valid(&self) -> Image<bool> {
        self.source.map(|&[x, y]| self.has_color(x, y))
    }

    fn has_color(&self, x: f32, y: f32) -> bool {
        // Without a pixel the range is empty.
        let inside = |x: f32, size: usize| x >= 0.0 && x <= size as f32 - 1.0;
        inside(x, self.source.width()) && inside(y, self.source.height())
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

fn nearest<T: Copy>(image: &Image<T>, x: f32, y: f32) -> Option<T> {
    let (u, v) = (x + 0.5, y + 0.5);
    (u >= 0.0 && v >= 0.0)
        .then(|| image.get(u as usize, v as usize))
        .flatten()
}
