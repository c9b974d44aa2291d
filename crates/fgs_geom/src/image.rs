//! A row-major image with any pixel type.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The number of values does not match the image's size.
#[derive(Debug, Error, PartialEq, Eq)]
#[error("an image of {width}x{height} needs {} values, got {len}", width.saturating_mul(*height))]
pub struct ImageSizeError {
    width: usize,
    height: usize,
    len: usize,
}

/// `width` x `height` pixels, row-major: pixel (u, v) is at `v * width + u`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Parts<T>")]
pub struct Image<T> {
    width: usize,
    height: usize,
    data: Vec<T>,
}

/// An image as it is read, before its size has been checked.
#[derive(Deserialize)]
struct Parts<T> {
    width: usize,
    height: usize,
    data: Vec<T>,
}

impl<T> TryFrom<Parts<T>> for Image<T> {
    type Error = ImageSizeError;

    fn try_from(parts: Parts<T>) -> Result<Self, ImageSizeError> {
        Self::new(parts.width, parts.height, parts.data)
    }
}

impl<T> Image<T> {
    /// Creates an image from row-major values.
    ///
    /// # Errors
    /// If `data` does not hold `width * height` values.
    pub fn new(width: usize, height: usize, data: Vec<T>) -> Result<Self, ImageSizeError> {
        let len = data.len();
        if width.checked_mul(height) != Some(len) {
            return Err(ImageSizeError { width, height, len });
        }
        Ok(Self {
            width,
            height,
            data,
        })
    }

    /// Creates an image by calling `pixel(u, v)` for each column `u` and row `v`, in row-major
    /// order.
    pub fn from_fn(width: usize, height: usize, mut pixel: impl FnMut(usize, usize) -> T) -> Self {
        let mut data = Vec::with_capacity(width * height);
        for v in 0..height {
            data.extend((0..width).map(|u| pixel(u, v)));
        }
        Self {
            width,
            height,
            data,
        }
    }

    /// Width, pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height, pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All pixels, row-major.
    pub fn data(&self) -> &[T] {
        &self.data
    }

    /// All pixels, row-major, mutable.
    pub fn data_mut(&mut self) -> &mut [T] {
        &mut self.data
    }

    /// Consumes the image and returns its pixels, row-major.
    pub fn into_data(self) -> Vec<T> {
        self.data
    }

    /// The pixels of row `v`.
    ///
    /// # Panics
    /// If there is no such row.
    #[inline]
    #[track_caller]
    pub fn row(&self, v: usize) -> &[T] {
        if v >= self.height {
            self.outside(0, v);
        }
        &self.data[v * self.width..][..self.width]
    }

    #[cold]
    #[inline(never)]
    #[track_caller]
    fn outside(&self, u: usize, v: usize) -> ! {
        let Self { width, height, .. } = self;
        panic!("pixel ({u}, {v}) is outside an image of {width}x{height}");
    }

    /// An image of the same size with `f` applied to every pixel.
    pub fn map<U>(&self, f: impl FnMut(&T) -> U) -> Image<U> {
        Image {
            width: self.width,
            height: self.height,
            data: self.data.iter().map(f).collect(),
        }
    }
}

impl<T: Copy> Image<T> {
    /// An image with every pixel set to `value`.
    pub fn filled(width: usize, height: usize, value: T) -> Self {
        Self {
            width,
            height,
            data: vec![value; width * height],
        }
    }

    /// The pixel in column `u`, row `v`. Loops over whole images are faster by rows.
    ///
    /// # Panics
    /// Outside the image.
    #[inline]
    #[track_caller]
    pub fn at(&self, u: usize, v: usize) -> T {
        match self.get(u, v) {
            Some(value) => value,
            None => self.outside(u, v),
        }
    }

    /// The pixel in column `u`, row `v`, or `None` outside the image.
    #[inline]
    pub fn get(&self, u: usize, v: usize) -> Option<T> {
        (u < self.width && v < self.height).then(|| self.data[v * self.width + u])
    }

    /// Sets the pixel in column `u`, row `v`.
    ///
    /// # Panics
    /// Outside the image.
    #[inline]
    #[track_caller]
    pub fn set(&mut self, u: usize, v: usize, value: T) {
        if u >= self.width || v >= self.height {
            self.outside(u, v);
        }
        self.data[v * self.width + u] = value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_read_has_as_many_values_as_pixels() {
        let image = Image::from_fn(3, 2, |u, v| (10 * v + u) as u8);
        let bytes = postcard::to_stdvec(&image).unwrap();
        assert_eq!(postcard::from_bytes(&bytes), Ok(image));
        for size in [(2_usize, 2_usize), (usize::MAX, 3)] {
            let bytes = postcard::to_stdvec(&(size, [1_u8; 6].as_slice())).unwrap();
            assert!(
                postcard::from_bytes::<Image<u8>>(&bytes).is_err(),
                "{size:?}"
            );
        }
    }

    #[test]
    fn rows_and_columns() {
        let image = Image::from_fn(3, 2, |u, v| 10 * v + u);
        assert_eq!(image.data(), &[0, 1, 2, 10, 11, 12]);
        assert_eq!(image.row(1), &[10, 11, 12]);
        assert_eq!(image.get(2, 1), Some(12));
        assert_eq!(image.get(3, 1), None);
        assert_eq!(image.get(0, 2), None);
    }

    #[test]
    fn beyond_the_last_column_or_row_is_a_panic() {
        let image = Image::filled(3, 2, 0);
        let panics = |access: fn(&mut Image<i32>)| {
            let mut image = image.clone();
            std::panic::catch_unwind(move || access(&mut image)).is_err()
        };
        assert!(panics(|image| _ = image.at(3, 0)));
        assert!(panics(|image| _ = image.at(0, 2)));
        assert!(panics(|image| image.set(3, 0, 1)));
        assert!(panics(|image| image.set(0, usize::MAX / 3 + 1, 1)));
        assert!(panics(|image| _ = image.row(2)));
        assert!(panics(|_| _ = Image::filled(0, 2, 0).row(2)));
    }

    #[test]
    fn wrong_number_of_values() {
        assert!(Image::new(3, 2, vec![0; 5]).is_err());
        assert!(Image::new(usize::MAX, 2, vec![0; 5]).is_err());
    }
}
