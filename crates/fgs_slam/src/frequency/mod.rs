//! Where an image is rich in detail: the Fourier segmentation (Sec. III-A, Eq. 2 to 8).
//!
//! In: a colour or grey image. Out: the mask `M_h` of the pixels whose high-frequency response
//! stands out; `M_l` is its complement. Steps: grey, reflected border, optional local equalisation
//! ([`clahe`]), gaussian [`high_pass`], absolute value, [`triangle`] threshold.
//! Differs from the paper: the equalisation is a choice; the filter keeps zero frequency in bin 0
//! instead of shifting the spectrum to and fro, which is wrong for odd sizes.

mod border;
mod clahe;
#[cfg(test)]
mod fourier;
mod gray;
mod high_pass;
mod histogram;
mod levels;
mod triangle;

use fgs_geom::Image;

use border::{Border, reflect};
use clahe::Equalizer;
use high_pass::HighPass;
use histogram::histogram;

/// Pixels of reflected border, so that the filter, periodic by nature, does not meet the opposite
/// edge of the image (the authors' value).
const PADDING: usize = 10;

const BORDER: Border = Border {
    left: PADDING,
    top: PADDING,
    right: PADDING,
    bottom: PADDING,
};

/// D0 is the shorter side over this (the authors' value): 24 bins at 640x480.
const SHORTER_SIDE_PER_CUTOFF_BIN: usize = 20;

/// What can be chosen about the segmentation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrequencySettings {
    /// Equalise the image locally (contrast-limited, clip 2.0, a grid of 32x32 tiles) beforehand.
    pub clahe: bool,
}

/// Segments images of one size; filter and buffers are made once.
pub struct FrequencySegmenter {
    gray: Image<u8>,
    /// The grey image with its border, then equalised.
    padded: Image<u8>,
    equalizer: Option<Equalizer>,
    high_pass: HighPass,
    /// The response in 256 levels.
    levels: Image<u8>,
}

impl FrequencySegmenter {
    /// For images of `width` x `height` pixels.
    pub fn new(width: usize, height: usize, settings: FrequencySettings) -> Self {
        let padded = BORDER.canvas(width, height);
        Self {
            gray: Image::filled(width, height, 0),
            equalizer: (settings.clahe).then(|| Equalizer::new(padded.width(), padded.height())),
            high_pass: HighPass::new(
                padded.width(),
                padded.height(),
                width.min(height) / SHORTER_SIDE_PER_CUTOFF_BIN,
                PADDING,
            ),
            padded,
            levels: Image::filled(width, height, 0),
        }
    }

    /// The mask `M_h` of a colour image: true where the response lies strictly above the triangle
    /// threshold, nowhere if the image is constant. An image of another size than planned for is
    /// planned for anew.
    pub fn segment(&mut self, color: &Image<[u8; 3]>) -> Image<bool> {
        self.plan(color.width(), color.height());
        gray::gray_from_color(color, &mut self.gray);
        self.mask()
    }

    /// [`segment`](Self::segment) for an image that is grey already.
    pub fn segment_gray(&mut self, gray: &Image<u8>) -> Image<bool> {
        self.plan(gray.width(), gray.height());
        self.gray.data_mut().copy_from_slice(gray.data());
        self.mask()
    }

    fn plan(&mut self, width: usize, height: usize) {
        if (width, height) != (self.gray.width(), self.gray.height()) {
            let clahe = self.equalizer.is_some();
            *self = Self::new(width, height, FrequencySettings { clahe });
        }
    }

    /// The mask of the grey image.
    fn mask(&mut self) -> Image<bool> {
        let mut mask = Image::filled(self.gray.width(), self.gray.height(), false);
        if mask.data().is_empty() {
            return mask;
        }
        reflect(&self.gray, BORDER, &mut self.padded);
        if let Some(equalizer) = &mut self.equalizer {
            equalizer.equalize(&mut self.padded);
        }
        let response = self.high_pass.apply(&self.padded);
        let levels = self.levels.data_mut();
        levels::scale_response(response, levels);
        let threshold = triangle::triangle_threshold(&histogram([&*levels].into_iter()));
        levels::mark_above(threshold, levels, mask.data_mut());
        mask
    }
}

/// The nearest integer, of two equally near ones the even one, of a value in 0..=255. At 2^23 floats
/// are 1 apart, so adding it rounds; `round_ties_even` is a function call on older processors.
fn byte_from_float(value: f32) -> u8 {
    (value + 8_388_608.0).to_bits() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    fn segmenter(clahe: bool) -> FrequencySegmenter {
        FrequencySegmenter::new(0, 0, FrequencySettings { clahe })
    }

    /// Flat but for a patch of fine checks.
    fn checks(width: usize, height: usize) -> Image<u8> {
        Image::from_fn(width, height, |u, v| {
            let patch = u >= width / 2 && v >= height / 2;
            if patch && (u + v) % 2 == 0 { 180 } else { 100 }
        })
    }

    #[test]
    fn fine_checks_are_high_frequency_and_the_wall_is_not() {
        let mask = segmenter(false).segment_gray(&checks(120, 90));
        let share = |columns: std::ops::Range<usize>, rows: std::ops::Range<usize>| {
            let area = columns.len() * rows.len();
            let high = rows.map(|v| mask.row(v)[columns.clone()].iter().filter(|&&m| m).count());
            high.sum::<usize>() as f64 / area as f64
        };
        assert_eq!(share(70..110, 55..80), 1.0);
        assert_eq!(share(0..40, 0..90), 0.0);
        assert_eq!(share(0..120, 0..30), 0.0);
    }

    #[test]
    fn a_constant_image_has_no_high_frequencies() {
        for clahe in [false, true] {
            for (width, height) in [(1, 1), (2, 1), (64, 48), (333, 215), (640, 480)] {
                for level in [0, 1, 77, 255] {
                    let mask = segmenter(clahe).segment_gray(&Image::filled(width, height, level));
                    assert_eq!(mask, Image::filled(width, height, false));
                }
            }
        }
    }

    #[test]
    fn one_odd_pixel_is_enough() {
        let mut image = Image::filled(640, 480, 255);
        image.set(400, 100, 254);
        let mask = segmenter(false).segment_gray(&image);
        assert!(mask.at(400, 100));
        assert!(mask.data().iter().filter(|&&high| high).count() <= 1000);
    }

    #[test]
    fn images_of_any_size_are_segmented() {
        for clahe in [false, true] {
            for (width, height) in [(0, 0), (0, 5), (1, 1), (1, 30), (5, 3), (11, 10), (19, 40)] {
                let mask = segmenter(clahe).segment_gray(&checks(width, height));
                assert_eq!((mask.width(), mask.height()), (width, height));
            }
        }
    }

    #[test]
    fn color_is_segmented_by_its_gray() {
        let color = Image::from_fn(90, 70, |u, v| [(u * v % 251) as u8, (u * u) as u8, v as u8]);
        let mask = segmenter(true).segment(&color);
        let mut gray = Image::filled(90, 70, 0);
        gray::gray_from_color(&color, &mut gray);
        let expected = segmenter(true).segment_gray(&gray);
        assert_eq!(mask, expected);
        assert!(mask.data().contains(&true) && mask.data().contains(&false));
    }

    #[test]
    fn a_planned_segmenter_takes_images_of_another_size() {
        let mut planned = FrequencySegmenter::new(200, 100, FrequencySettings { clahe: false });
        planned.segment_gray(&checks(200, 100));
        let image = checks(77, 130);
        let expected = segmenter(false).segment_gray(&image);
        assert_eq!(planned.segment_gray(&image), expected);
        // Nothing is left of the image before.
        let flat = Image::filled(77, 130, 90);
        assert!(!planned.segment_gray(&flat).data().contains(&true));
        assert_eq!(planned.segment_gray(&image), expected);
    }
}
