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

/// The image with a reflected border. A border wider than the image is reflected again and again.
/// An image without pixels stays as it is.
pub(super) fn reflect(image: &Image<u8>, border: Border) -> Image<u8> {
    let (width, height) = (image.width(), image.height());
    if width == 0 || height == 0 {
        return image.clone();
    }
    let sources = |before: usize, len: usize, after: usize| -> Vec<usize> {
        let reflected = |index| reflected_index(index, before, len);
        (0..before + len + after).map(reflected).collect()
    };
    let columns = sources(border.left, width, border.right);
    let rows = sources(border.top, height, border.bottom);
    let (before, after) = (&columns[..border.left], &columns[border.left + width..]);
    let mut reflected = Image::filled(columns.len(), rows.len(), image.at(0, 0));
    for (to, &v) in reflected.data_mut().chunks_mut(columns.len()).zip(&rows) {
        let from = image.row(v);
        let (left, rest) = to.split_at_mut(border.left);
        let (middle, right) = rest.split_at_mut(width);
        left.iter_mut()
            .zip(before)
            .for_each(|(to, &u)| *to = from[u]);
        middle.copy_from_slice(from);
        right
            .iter_mut()
            .zip(after)
            .for_each(|(to, &u)| *to = from[u]);
    }
    reflected
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
        let reflected = reflect(&image, border);
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
        let reflected = reflect(&Image::filled(1, 1, 7), border);
        assert_eq!(reflected, Image::filled(5, 7, 7));
    }
}
