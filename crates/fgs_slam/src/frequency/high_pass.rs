//! The gaussian high-pass filter (Sec. III-A, Eq. 3 to 6) as a convolution.
//!
//! In: an image as real numbers. Out: the image filtered by `H(u, v) = 1 - exp(-D^2 / (2 D0^2))`,
//! with D the distance in bins from zero frequency, on the periodic image. The exponential is the
//! product of one factor in u and one in v, each the transform of a (nearly gaussian) kernel with
//! `sigma = len / (2 pi D0)`: what the filter removes is a separable blur. Cut at 5 sigma it is
//! equal to the Fourier transform, which the tests hold it against, but for rounding, at a fraction
//! of its cost.
//! Differs from the paper: no spectrum is made, and so none has to be shifted (Eq. 3).

use std::f64::consts::TAU;

/// Half of the kernel's length in sigmas: beyond lie 6e-7 of its weight. With 4 (6e-5) the masks of
/// drawn images, whose responses crowd at a few levels, can turn over.
const KERNEL_SIGMAS: f64 = 5.0;

/// A filter for images of one size.
pub(super) struct HighPass {
    width: usize,
    height: usize,
    across: Kernel,
    down: Kernel,
    filtered: Vec<f32>,
}

impl HighPass {
    /// For images of `width` x `height` pixels, `cutoff_bins` being D0, at most a tenth of either
    /// side (the kernels of more rings beyond 5 sigma). With D0 = 0 the filter takes the limit: it
    /// removes the mean and keeps everything else.
    pub fn new(width: usize, height: usize, cutoff_bins: usize) -> Self {
        Self {
            width,
            height,
            across: Kernel::new(width, cutoff_bins),
            down: Kernel::new(height, cutoff_bins),
            filtered: vec![0.0; width * height],
        }
    }

    /// The filtered image. Both are row-major and of the filter's size.
    pub fn apply(&mut self, image: &[f32]) -> &[f32] {
        debug_assert_eq!(image.len(), self.width * self.height);
        pulp::Arch::new().dispatch(Convolution {
            filter: self,
            image,
        });
        &self.filtered
    }
}

/// A symmetric kernel: `weights[k]` is that of the pixels k before and k after.
struct Kernel {
    weights: Vec<f32>,
}

impl Kernel {
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
    image: &'a [f32],
}

impl pulp::WithSimd for Convolution<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let HighPass {
            width,
            height,
            across,
            down,
            filtered,
        } = self.filter;
        let (width, height) = (*width, *height);
        let margin = across.weights.len() - 1;
        // A row blurred downwards, with its periodic continuation on either side.
        let mut blurred = vec![0.0; width + 2 * margin];
        let mut low = vec![0.0; width];
        let row = |v: usize| &self.image[v % height * width..][..width];
        for (v, filtered) in filtered.chunks_mut(width.max(1)).enumerate() {
            let middle = &mut blurred[margin..margin + width];
            convolve(middle, &down.weights, |k| [row(v + height - k), row(v + k)]);
            blurred.copy_within(width..width + margin, 0);
            blurred.copy_within(margin..2 * margin, margin + width);
            convolve(&mut low, &across.weights, |k| {
                [
                    &blurred[margin - k..][..width],
                    &blurred[margin + k..][..width],
                ]
            });
            for ((filtered, image), low) in filtered.iter_mut().zip(row(v)).zip(&low) {
                *filtered = image - low;
            }
        }
    }
}

/// `sum = w_0 before(0) + sum_k w_k (before(k) + after(k))`.
#[inline(always)]
fn convolve<'a>(sum: &mut [f32], weights: &[f32], lines: impl Fn(usize) -> [&'a [f32]; 2]) {
    // So many pixels stay in registers while the taps run over them.
    const BLOCK: usize = 64;
    let len = sum.len();
    let tap = |k: usize, weight: f32| if k == 0 { 0.5 * weight } else { weight };
    if len < BLOCK {
        sum.fill(0.0);
        for (k, &weight) in weights.iter().enumerate() {
            let [before, after] = lines(k);
            for ((sum, a), b) in sum.iter_mut().zip(before).zip(after) {
                *sum += tap(k, weight) * (a + b);
            }
        }
        return;
    }
    // The last block overlaps the one before.
    for start in (0..len).step_by(BLOCK).map(|start| start.min(len - BLOCK)) {
        let mut block = [0.0; BLOCK];
        for (k, &weight) in weights.iter().enumerate() {
            let weight = tap(k, weight);
            let [before, after] = lines(k).map(|line| line[start..].first_chunk::<BLOCK>());
            if let (Some(before), Some(after)) = (before, after) {
                for i in 0..BLOCK {
                    block[i] += weight * (before[i] + after[i]);
                }
            }
        }
        sum[start..start + BLOCK].copy_from_slice(&block);
    }
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
        let image: Vec<f32> = (0..width * height)
            .map(|_| random.random_range(0.0..255.0))
            .collect();
        let exact: Vec<f64> = image.iter().map(|&x| x.into()).collect();
        let expected = fourier::HighPass::new(width, height, cutoff_bins).apply(&exact);
        let mut filter = HighPass::new(width, height, cutoff_bins);
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
        let mut filter = HighPass::new(300, 200, 10);
        let filtered = filter.apply(&[77.0; 300 * 200]);
        assert!(filtered.iter().all(|x| x.abs() <= 1e-4));
    }

    #[test]
    fn an_empty_image_stays_empty() {
        assert!(HighPass::new(0, 0, 0).apply(&[]).is_empty());
    }
}
