//! Borders by reflection without repeating the edge pixel: `gfedcb|abcdefgh|gfedcba`
//! (OpenCV's BORDER_REFLECT_101).

use fgs_geom::Image;

/// Pixels to add on each side.
#[derive(Clone, Copy)]
pub(super) struct Border {
    pub left: usize,
    pub top: usize,
    pub right: usize,
    pub bottom: usize,
}

impl Border {
    /// An image with room for one of `width` x `height` pixels and its border.
    pub fn canvas(&self, width: usize, height: usize) -> Image<u8> {
        let (width, height) = (
            self.left + width + self.right,
            self.top + height + self.bottom,
        );
        Image::filled(width, height, 0)
    }
}

/// Puts the image with a reflected border on its [canvas](Border::canvas). A border wider than the
/// image is reflected again and again. An image without pixels leaves the canvas as it is.
pub(super) fn reflect(image: &Image<u8>, border: Border, canvas: &mut Image<u8>) {
    let (width, height) = (image.width(), image.height());
    if width == 0 || height == 0 {
        return;
    }
    let columns = canvas.width();
    let column = |u: usize| reflected_index(u, border.left, width);
    for (v, to) in canvas.data_mut().chunks_mut(columns).enumerate() {
        let from = image.row(reflected_index(v, border.top, height));
        to[border.left..][..width].copy_from_slice(from);
        for u in (0..border.left).chain(border.left + width..columns) {
            to[u] = from[column(u)];
        }
    }
}

/// The index in `0..len` seen at `index - offset`.
fn reflected_index(index: usize, offset: usize, len: usize) -> usize {
    let period = 2 * (len - 1).max(1);
    let phase = (index as isize - offset as isize).rem_euclid(period as isize) as usize;
    phase.min(period - phase).min(len - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_edge_is_not_repeated() {
        let image = Image::new(3, 2, vec![1, 2, 3, 4, 5, 6]).unwrap();
        let border = Border {
            left: 2,
            top: 1,
            right: 3,
            bottom: 0,
        };
        let mut reflected = border.canvas(3, 2);
        reflect(&image, border, &mut reflected);
        assert_eq!(reflected.row(0), &[6, 5, 4, 5, 6, 5, 4, 5]);
        assert_eq!(reflected.row(1), &[3, 2, 1, 2, 3, 2, 1, 2]);
        assert_eq!((reflected.width(), reflected.height()), (8, 3));
    }

    #[test]
    fn a_single_pixel_fills_its_border() {
        let border = Border {
            left: 3,
            top: 2,
            right: 1,
            bottom: 4,
        };
        let mut reflected = border.canvas(1, 1);
        reflect(&Image::filled(1, 1, 7), border, &mut reflected);
        assert_eq!(reflected, Image::filled(5, 7, 7));
    }
}
