//! Where an image is rich in detail: the Fourier segmentation (Sec. III-A, Eq. 2 to 8).
//!
//! In: a colour or grey image. Out: the mask `M_h` of the pixels whose high-frequency response
//! stands out; `M_l` is its complement. Steps: grey, reflected border, optional local equalisation
//! (`clahe`), gaussian `high_pass`, absolute value, `triangle` threshold. Pixels that the camera did
//! not see make no detail: see `unseen`.
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
mod unseen;

use std::sync::Arc;

use fgs_geom::{Image, RgbdFrame};

use border::{Border, reflect};
use clahe::Equalizer;
use high_pass::HighPass;
use histogram::histogram;
use unseen::Unseen;

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
    /// Of the image at hand; `None` if the camera saw every pixel.
    unseen: Option<Unseen>,
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
            unseen: None,
        }
    }

    /// The mask `M_h` of a frame, false where the camera did not see its colour; see
    /// [`segment`](Self::segment).
    pub fn segment_frame(&mut self, frame: &RgbdFrame) -> Image<bool> {
        self.plan(frame.color.width(), frame.color.height());
        let size = (self.gray.width(), self.gray.height());
        let seen = (frame.color_valid.as_ref()).filter(|s| (s.width(), s.height()) == size);
        // Frames of one recording share their mask.
        self.unseen = seen.map(|seen| match self.unseen.take() {
            Some(unseen) if Arc::ptr_eq(unseen.seen(), seen) => unseen,
            _ => Unseen::new(seen.clone()),
        });
        gray::gray_from_color(&frame.color, &mut self.gray);
        self.mask()
    }

    /// The mask `M_h` of a colour image without unseen pixels: true where the response lies strictly
    /// above the triangle threshold, nowhere if the image is constant. An image of another size than
    /// planned for is planned for anew.
    pub fn segment(&mut self, color: &Image<[u8; 3]>) -> Image<bool> {
        self.plan(color.width(), color.height());
        self.unseen = None;
        gray::gray_from_color(color, &mut self.gray);
        self.mask()
    }

    /// [`segment`](Self::segment) for an image that is grey already.
    pub fn segment_gray(&mut self, gray: &Image<u8>) -> Image<bool> {
        self.plan(gray.width(), gray.height());
        self.unseen = None;
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
        if let Some(unseen) = &self.unseen {
            unseen.fill(self.gray.data_mut());
        }
        reflect(&self.gray, BORDER, &mut self.padded);
        if let Some(equalizer) = &mut self.equalizer {
            equalizer.equalize(&mut self.padded);
        }
        let response = self.high_pass.apply(&self.padded);
        if let Some(unseen) = &self.unseen {
            unseen.fill(response);
        }
        let levels = self.levels.data_mut();
        levels::scale_response(response, levels);
        let counts = match &self.unseen {
            Some(unseen) => histogram(unseen.seen_of(levels)),
            None => histogram([&*levels].into_iter()),
        };
        levels::mark_above(
            triangle::triangle_threshold(&counts),
            levels,
            mask.data_mut(),
        );
        if let Some(unseen) = &self.unseen {
            unseen.clear(mask.data_mut());
        }
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

    /// A smooth frame whose lens left a black border of 15 to 25 pixels, with a patch of checks.
    fn bordered_frame() -> RgbdFrame {
        let (width, height) = (160, 120);
        let intrinsics = fgs_geom::Intrinsics {
            fx: 150.0,
            fy: 150.0,
            cx: 79.5,
            cy: 59.5,
        };
        let seen = Image::from_fn(width, height, |u, v| {
            let from_edge = u.min(width - 1 - u).min(v).min(height - 1 - v);
            from_edge >= 15 + (u / 9 + v / 7) % 10
        });
        let color = Image::from_fn(width, height, |u, v| {
            let checks = (70..90).contains(&u) && (50..70).contains(&v) && (u + v) % 2 == 0;
            let shade = 140 + (u + v) / 8 + if checks { 50 } else { 0 };
            [if seen.at(u, v) { shade as u8 } else { 0 }; 3]
        });
        let camera = fgs_geom::Camera::new(width, height, intrinsics).unwrap();
        let depth_m = Image::filled(width, height, 1.0);
        let index = fgs_geom::FrameIndex(0);
        RgbdFrame::new(index, 0.0, color, depth_m, camera)
            .and_then(|frame| frame.with_color_valid(Arc::new(seen)))
            .unwrap()
    }

    #[test]
    fn a_border_that_was_not_seen_is_no_detail() {
        let frame = bordered_frame();
        for clahe in [false, true] {
            let mask = segmenter(clahe).segment_frame(&frame);
            let blind = segmenter(clahe).segment(&frame.color);
            let marked = |mask: &Image<bool>, near: bool| {
                let pixels = (0..120).flat_map(|v| (0..160).map(move |u| (u, v)));
                let is_near =
                    |u: usize, v: usize| !(50..110).contains(&u) || !(30..90).contains(&v);
                let pixels = pixels.filter(|&(u, v)| is_near(u, v) == near && mask.at(u, v));
                pixels.count()
            };
            assert!(marked(&blind, true) >= 500, "{}", marked(&blind, true));
            assert!(marked(&mask, false) >= 400);
            let (near, unseen) = (marked(&mask, true), |i: usize| {
                !frame.color_valid.as_ref().unwrap().data()[i]
            });
            assert!(near <= if clahe { 150 } else { 0 }, "{near}");
            assert!((0..160 * 120).all(|i| !(unseen(i) && mask.data()[i])));
        }
    }

    /// A ramp with a hole: what fills it from either side meets in an edge stronger than any seen.
    #[test]
    fn range_and_threshold_are_those_of_the_seen_pixels() {
        let (width, height) = (160, 120);
        let mut frame = bordered_frame();
        let seen = Image::from_fn(width, height, |u, v| {
            !(30..130).contains(&u) || !(30..90).contains(&v)
        });
        // Around the hole lies fine detail, which fills it.
        frame.color = Image::from_fn(width, height, |u, v| {
            let is_rim = (28..132).contains(&u) && (28..92).contains(&v);
            let noise = (31 * u * u + 17 * v * v + 7 * u * v) % 97;
            [(u + noise / if is_rim { 3 } else { 9 }) as u8; 3]
        });
        let frame = frame.with_color_valid(Arc::new(seen.clone())).unwrap();
        let mask = segmenter(false).segment_frame(&frame);

        let unseen = Unseen::new(Arc::new(seen));
        let mut gray = Image::filled(width, height, 0);
        gray::gray_from_color(&frame.color, &mut gray);
        unseen.fill(gray.data_mut());
        let mut padded = BORDER.canvas(width, height);
        reflect(&gray, BORDER, &mut padded);
        let (w, h) = (padded.width(), padded.height());
        let mut filter = HighPass::new(w, h, height / SHORTER_SIDE_PER_CUTOFF_BIN, PADDING);
        let response: Vec<f32> =
            (unseen.seen_of(filter.apply(&padded)).flatten().copied()).collect();
        let mut levels = vec![0; response.len()];
        levels::scale_response(&response, &mut levels);
        let threshold = triangle::triangle_threshold(&histogram([&*levels].into_iter()));
        let expected = levels.iter().map(|level| i32::from(*level) > threshold);
        assert!(expected.clone().any(|high| high) && !expected.clone().all(|high| high));
        assert!(unseen.seen_of(mask.data()).flatten().copied().eq(expected));
    }

    #[test]
    fn what_the_unseen_pixels_hold_does_not_matter() {
        let mut frame = bordered_frame();
        let mut planned = segmenter(true);
        let expected = planned.segment_frame(&frame);
        let seen = frame.color_valid.clone().unwrap();
        for (color, seen) in frame.color.data_mut().iter_mut().zip(seen.data()) {
            if !seen {
                *color = [255, 0, 9];
            }
        }
        assert_eq!(planned.segment_frame(&frame), expected);
        // A mask that excludes nothing is no mask, and none is kept from the frame before.
        let all = Arc::new(Image::filled(160, 120, true));
        let open = frame.clone().with_color_valid(all).unwrap();
        assert_eq!(planned.segment_frame(&open), planned.segment(&frame.color));
        let none = Arc::new(Image::filled(160, 120, false));
        let blind = frame.with_color_valid(none).unwrap();
        assert!(!planned.segment_frame(&blind).data().contains(&true));
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
