//! The gaussian high-pass filter (Sec. III-A, Eq. 3 to 6) as a convolution.
//!
//! In: an 8-bit image. Out: the image without its border, filtered by `H(u, v) = 1 - exp(-D^2 / (2 D0^2))`,
//! with D the distance in bins from zero frequency, on the periodic image. The exponential is the
//! product of one factor in u and one in v, each the transform of a (nearly gaussian) kernel with
//! `sigma = len / (2 pi D0)`: what the filter removes is a separable blur. Cut at 5 sigma it is
//! equal to the Fourier transform, which the tests hold it against, but for rounding, at a fraction
//! of its cost.
//! Differs from the paper: no spectrum is made, and so none has to be shifted (Eq. 3).

use std::f64::consts::TAU;

use fgs_geom::Image;

/// Half of the kernel's length in sigmas: beyond lie 6e-7 of its weight. With 4 (6e-5) the masks of
/// drawn images, whose responses crowd at a few levels, can turn over.
const KERNEL_SIGMAS: f64 = 5.0;

/// So many pixels stay in registers while the taps run over them.
const BLOCK: usize = 64;

/// Pixels side by side. Aligned to cache lines, of which the widest registers hold a whole one.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct Block([f32; BLOCK]);

/// Rows that are blurred downwards, then across: few enough to stay in the second-level cache.
const BAND: usize = 64;

/// A filter for images of one size.
pub(super) struct HighPass {
    width: usize,
    height: usize,
    border: usize,
    across: Kernel,
    down: Kernel,
    /// The pixels of some columns that a band depends on.
    columns: Vec<Block>,
    /// A band blurred downwards, row by row, with its periodic continuation on either side.
    band: Vec<f32>,
    filtered: Vec<f32>,
}

impl HighPass {
    /// For images of `width` x `height` pixels, `cutoff_bins` being D0, at most a tenth of either
    /// side (the kernels of more rings beyond 5 sigma). With D0 = 0 the filter takes the limit: it
    /// removes the mean and keeps everything else. Pixels less than `border` from the edge are left
    /// out of the result.
    pub fn new(width: usize, height: usize, cutoff_bins: usize, border: usize) -> Self {
        let (across, down) = (
            Kernel::new(width, cutoff_bins),
            Kernel::new(height, cutoff_bins),
        );
        let inside = |len: usize| len.saturating_sub(2 * border);
        Self {
            width,
            height,
            border,
            columns: vec![Block([0.0; BLOCK]); BAND + 2 * down.radius()],
            // The last block may reach beyond the row.
            band: vec![0.0; BAND * (width + 2 * across.radius() + BLOCK)],
            filtered: vec![0.0; inside(width) * inside(height)],
            across,
            down,
        }
    }

    /// The filtered image without its border, row by row.
    pub fn apply(&mut self, image: &Image<u8>) -> &mut [f32] {
        debug_assert_eq!((image.width(), image.height()), (self.width, self.height));
        fgs_geom::dispatch(Convolution {
            filter: self,
            image,
        });
        &mut self.filtered
    }
}

/// A symmetric kernel: `weights[k]` is that of the pixels k before and k after.
struct Kernel {
    weights: Vec<f32>,
}

impl Kernel {
    fn radius(&self) -> usize {
        self.weights.len() - 1
    }

    /// The inverse transform of `exp(-bin^2 / (2 D0^2))` over a line of `len` pixels.
    fn new(len: usize, cutoff_bins: usize) -> Self {
        let (n, cutoff) = (len as f64, cutoff_bins as f64);
        let sigma = n / (TAU * cutoff); // infinite for D0 = 0
        let radius = ((KERNEL_SIGMAS * sigma).ceil() as usize).min(len / 2);
        let gain = |bin: f64| (-0.5 * (bin / cutoff).powi(2)).exp();
        let mut weights: Vec<f64> = (0..=radius)
            .map(|k| {
                let wave = |bin: usize| (TAU * (bin * k % len.max(1)) as f64 / n).cos();
                // Bins 1 to len / 2 stand for themselves and their mirror images, except the last
                // of an even number, which is its own.
                let pairs = (1..=len / 2).map(|bin| {
                    let images = if 2 * bin == len { 1.0 } else { 2.0 };
                    images * gain(bin as f64) * wave(bin)
                });
                (1.0 + pairs.sum::<f64>()) / n
            })
            .collect();
        // Half a period away, before and after are the same pixel.
        if 2 * radius == len && radius > 0 {
            weights[radius] *= 0.5;
        }
        // What was cut off must not turn grey into structure.
        let total = weights[0] + 2.0 * weights[1..].iter().sum::<f64>();
        Self {
            weights: weights.iter().map(|w| (w / total) as f32).collect(),
        }
    }
}

/// The work, compiled for each instruction set.
struct Convolution<'a> {
    filter: &'a mut HighPass,
    image: &'a Image<u8>,
}

impl fgs_geom::Kernel for Convolution<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool, const WIDTH: usize>(self) {
        let HighPass {
            width,
            height,
            border,
            ..
        } = *self.filter;
        let line_len = self.filter.band.len() / BAND;
        let end = height.saturating_sub(border);
        for top in (border..end).step_by(BAND) {
            let rows = top..end.min(top + BAND);
            for left in (0..width).step_by(BLOCK) {
                self.filter.blur_downwards(self.image, rows.clone(), left);
            }
            let inner_width = width.saturating_sub(2 * border);
            let filtered = &mut self.filter.filtered[(top - border) * inner_width..];
            let lines = self.filter.band.chunks_mut(line_len);
            for ((v, line), filtered) in rows.zip(lines).zip(filtered.chunks_mut(inner_width)) {
                let row = &self.image.row(v)[border..width - border];
                subtract_blur(row, line, width, border, &self.filter.across, filtered);
            }
        }
    }
}

impl HighPass {
    /// Blurs the rows of a band downwards, in a block of columns.
    #[inline(always)]
    fn blur_downwards(&mut self, image: &Image<u8>, rows: std::ops::Range<usize>, left: usize) {
        let (radius, margin) = (self.down.radius(), self.across.radius());
        let line_len = self.band.len() / BAND;
        let block_len = BLOCK.min(self.width - left);
        let columns = &mut self.columns[..rows.len() + 2 * radius];
        for (i, to) in columns.iter_mut().enumerate() {
            let from = &image.row((rows.start + i + self.height - radius) % self.height)[left..];
            for (to, &level) in to.0[..block_len].iter_mut().zip(from) {
                *to = level.into();
            }
        }
        for (i, line) in (radius..).zip(self.band.chunks_mut(line_len).take(rows.len())) {
            let before = columns[i - radius..=i].iter().rev().map(|block| &block.0);
            let after = columns[i..].iter().map(|block| &block.0);
            let blurred = convolve(&self.down.weights, before, after);
            line[margin + left..][..block_len].copy_from_slice(&blurred[..block_len]);
        }
    }
}

/// What is left of a row's inside after the blur, given the whole row blurred downwards.
#[inline(always)]
fn subtract_blur<'a>(
    row: &[u8],
    line: &'a mut [f32],
    width: usize,
    border: usize,
    across: &Kernel,
    filtered: &mut [f32],
) {
    let margin = across.radius();
    line.copy_within(width..width + margin, 0);
    line.copy_within(margin..2 * margin, margin + width);
    let blocks = filtered.chunks_mut(BLOCK).zip(row.chunks(BLOCK));
    for (middle, (filtered, row)) in (margin + border..).step_by(BLOCK).zip(blocks) {
        let block = |window: &'a [f32]| window.first_chunk().unwrap_or(&[0.0; BLOCK]);
        let before = line[middle - margin..middle + BLOCK].windows(BLOCK).rev();
        let after = line[middle..].windows(BLOCK);
        let low = convolve(&across.weights, before.map(block), after.map(block));
        for ((filtered, &level), low) in filtered.iter_mut().zip(row).zip(low) {
            *filtered = f32::from(level) - low;
        }
    }
}

/// `sum_k w_k (before_k + after_k)`, the pixel itself, k = 0, counting once.
#[inline(always)]
fn convolve<'a>(
    weights: &[f32],
    before: impl IntoIterator<Item = &'a [f32; BLOCK]>,
    after: impl IntoIterator<Item = &'a [f32; BLOCK]>,
) -> [f32; BLOCK] {
    let mut sum = [0.0; BLOCK];
    for ((k, &weight), (before, after)) in weights
        .iter()
        .enumerate()
        .zip(before.into_iter().zip(after))
    {
        let weight = if k == 0 { 0.5 * weight } else { weight };
        for i in 0..BLOCK {
            sum[i] += weight * (before[i] + after[i]);
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::super::fourier;
    use super::*;

    /// The largest difference from the Fourier transform, over the largest response.
    fn error(width: usize, height: usize, cutoff_bins: usize) -> f64 {
        let mut random = Pcg64Mcg::seed_from_u64(1);
        let image = Image::from_fn(width, height, |_, _| random.random());
        let exact: Vec<f64> = image.data().iter().map(|&x: &u8| x.into()).collect();
        let expected = fourier::HighPass::new(width, height, cutoff_bins).apply(&exact);
        let mut filter = HighPass::new(width, height, cutoff_bins, 0);
        let filtered = filter.apply(&image);
        let largest = expected.iter().fold(0.0, |a: f64, b| a.max(b.abs()));
        let errors = filtered.iter().zip(&expected);
        let errors = errors.map(|(a, b)| (f64::from(*a) - b).abs());
        errors.fold(0.0, |a: f64, b| if b <= a { a } else { b }) / largest
    }

    #[test]
    fn equals_the_fourier_transform() {
        for (width, height, cutoff_bins) in [
            (1, 5, 0),
            (4, 1, 0),
            (30, 31, 0),
            (41, 20, 1),
            (20, 60, 2),
            (353, 235, 10),
            (129, 257, 6),
            (660, 500, 24),
        ] {
            let error = error(width, height, cutoff_bins);
            assert!(error <= 3e-6, "{width}x{height} {cutoff_bins}: {error:e}");
        }
    }

    #[test]
    fn a_constant_image_has_no_response() {
        let mut filter = HighPass::new(300, 200, 10, 0);
        let filtered = filter.apply(&Image::filled(300, 200, 77));
        assert!(filtered.iter().all(|x| x.abs() <= 1e-4));
    }

    #[test]
    fn a_border_is_left_out() {
        let image = Image::from_fn(150, 130, |u, v| (u * u + 7 * v) as u8);
        let mut filter = HighPass::new(150, 130, 6, 0);
        let whole = filter.apply(&image).chunks(150);
        let expected: Vec<f32> = whole
            .skip(10)
            .take(110)
            .flat_map(|row| row[10..140].to_vec())
            .collect();
        assert_eq!(HighPass::new(150, 130, 6, 10).apply(&image), expected);
    }

    #[test]
    fn an_empty_image_stays_empty() {
        assert!(
            HighPass::new(0, 0, 0, 0)
                .apply(&Image::filled(0, 0, 0))
                .is_empty()
        );
    }
}
