//! The gaussian high-pass filter in the frequency domain (Sec. III-A, Eq. 3 to 6): the definition
//! that [`high_pass`](super::high_pass) is tested against.
//!
//! In: an image as real numbers. Out: the image filtered by `H(u, v) = 1 - exp(-D^2 / (2 D0^2))`,
//! with D the distance in bins from zero frequency, on the periodic image. The exponential is the
//! product of one factor in u and one in v, so the low-pass part is taken line by line: along all
//! rows, then along all columns. Both factors are real and even, hence real lines stay real, and
//! one complex transform filters two lines at once, one as real, one as imaginary part.
//! Zero frequency sits at bin 0: nothing is shifted (Eq. 3 is a matter of indexing).

use std::sync::Arc;

use rustfft::{Fft, FftNum, FftPlanner, num_complex::Complex};

/// A filter for images of one size.
pub(super) struct HighPass<T: FftNum> {
    rows: LowPass<T>,
    columns: LowPass<T>,
}

impl<T: FftNum> HighPass<T> {
    /// For images of `width` x `height` pixels, `cutoff_bins` being D0. With D0 = 0 the filter
    /// takes the limit: it removes the mean and keeps everything else.
    pub fn new(width: usize, height: usize, cutoff_bins: usize) -> Self {
        let mut planner = FftPlanner::new();
        Self {
            rows: LowPass::new(width, cutoff_bins, &mut planner),
            columns: LowPass::new(height, cutoff_bins, &mut planner),
        }
    }

    /// The filtered image. Both are row-major and of the filter's size.
    pub fn apply(&mut self, image: &[T]) -> Vec<T> {
        let (width, height) = (self.rows.gain.len(), self.columns.gain.len());
        debug_assert_eq!(image.len(), width * height);
        let mut low = image.to_vec();
        for v in (0..height).step_by(2) {
            // An odd last line is filtered twice, as its own partner.
            let partner = (v + 1).min(height - 1);
            self.rows.apply(&mut low, [v * width, partner * width], 1);
        }
        for u in (0..width).step_by(2) {
            let partner = (u + 1).min(width - 1);
            self.columns.apply(&mut low, [u, partner], width);
        }
        image.iter().zip(low).map(|(&all, low)| all - low).collect()
    }
}

/// Multiplies the spectrum of a line by `exp(-u^2 / (2 D0^2))`.
struct LowPass<T: FftNum> {
    forward: Arc<dyn Fft<T>>,
    inverse: Arc<dyn Fft<T>>,
    /// The factor of each bin, over the line's length: rustfft's transforms are unnormalised.
    gain: Vec<T>,
    lines: Vec<Complex<T>>,
    scratch: Vec<Complex<T>>,
}

impl<T: FftNum> LowPass<T> {
    fn new(len: usize, cutoff_bins: usize, planner: &mut FftPlanner<T>) -> Self {
        let (forward, inverse) = (planner.plan_fft_forward(len), planner.plan_fft_inverse(len));
        let scratch_len = forward
            .get_inplace_scratch_len()
            .max(inverse.get_inplace_scratch_len());
        let gain = (0..len).map(|bin| {
            let distance = bin.min(len - bin) as f64 / cutoff_bins as f64; // NaN only for 0 / 0
            let gain = if bin == 0 {
                1.0
            } else {
                (-0.5 * distance * distance).exp()
            };
            T::from_f64(gain / len as f64).unwrap_or_else(T::zero)
        });
        Self {
            gain: gain.collect(),
            lines: vec![Complex::new(T::zero(), T::zero()); len],
            scratch: vec![Complex::new(T::zero(), T::zero()); scratch_len],
            forward,
            inverse,
        }
    }

    /// Filters two lines of `image` in place, given where each starts and the step between the
    /// pixels of a line.
    fn apply(&mut self, image: &mut [T], starts: [usize; 2], step: usize) {
        for (i, value) in self.lines.iter_mut().enumerate() {
            let [a, b] = starts.map(|start| image[start + i * step]);
            *value = Complex::new(a, b);
        }
        self.forward
            .process_with_scratch(&mut self.lines, &mut self.scratch);
        for (value, &gain) in self.lines.iter_mut().zip(&self.gain) {
            *value = *value * gain;
        }
        self.inverse
            .process_with_scratch(&mut self.lines, &mut self.scratch);
        for (i, value) in self.lines.iter().enumerate() {
            image[starts[0] + i * step] = value.re;
            image[starts[1] + i * step] = value.im;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// The two-dimensional DFT and its inverse by their sums, with H of Eq. (5) between them.
    fn naive(image: &[f64], width: usize, height: usize, cutoff_bins: f64) -> Vec<f64> {
        let dft = |image: &[Complex<f64>], sign: f64| -> Vec<Complex<f64>> {
            let mut out = vec![Complex::new(0.0, 0.0); image.len()];
            for (i, value) in out.iter_mut().enumerate() {
                let (u, v) = (i % width, i / width);
                for (j, pixel) in image.iter().enumerate() {
                    let (x, y) = (j % width, j / width);
                    let turns = (u * x) as f64 / width as f64 + (v * y) as f64 / height as f64;
                    *value += pixel * Complex::from_polar(1.0, sign * TAU * turns);
                }
            }
            out
        };
        let pixels: Vec<_> = image.iter().map(|&x| Complex::new(x, 0.0)).collect();
        let mut spectrum = dft(&pixels, -1.0);
        let signed = |bin: usize, len: usize| {
            let bin = bin as f64;
            if bin > len as f64 / 2.0 {
                bin - len as f64
            } else {
                bin
            }
        };
        for (i, value) in spectrum.iter_mut().enumerate() {
            let (u, v) = (signed(i % width, width), signed(i / width, height));
            *value *= 1.0 - (-(u * u + v * v) / (2.0 * cutoff_bins * cutoff_bins)).exp();
        }
        let len = image.len() as f64;
        dft(&spectrum, 1.0).iter().map(|x| x.re / len).collect()
    }

    #[test]
    fn equals_the_naive_transform() {
        let mut random = Pcg64Mcg::seed_from_u64(1);
        for (width, height) in [(8, 8), (9, 7), (7, 9), (1, 5)] {
            for cutoff_bins in [1, 2, 3] {
                let image: Vec<f64> = (0..width * height)
                    .map(|_| random.random_range(0.0..255.0))
                    .collect();
                let filtered = HighPass::new(width, height, cutoff_bins).apply(&image);
                let expected = naive(&image, width, height, cutoff_bins as f64);
                for (a, b) in filtered.iter().zip(&expected) {
                    assert!((a - b).abs() <= 1e-9, "{width}x{height} {cutoff_bins}");
                }
            }
        }
    }

    #[test]
    fn without_cutoff_only_the_mean_goes() {
        let filtered: Vec<f64> = HighPass::new(3, 2, 0).apply(&[1.0, 2.0, 3.0, 4.0, 5.0, 9.0]);
        for (a, b) in filtered.iter().zip([-3.0, -2.0, -1.0, 0.0, 1.0, 5.0]) {
            assert!((a - b).abs() <= 1e-12);
        }
    }
}
