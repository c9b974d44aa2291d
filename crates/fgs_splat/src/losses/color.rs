//! L1 and SSIM of the rendered colour.
//!
//! Input: rendered colour and the target. Output: both means over the valid pixels, and the
//! derivative of their weighted sum. The image is cut into strips of rows that are worked on
//! independently, each with the 10 rows above and below that its derivatives depend on, so that
//! what lies between input and output stays in the cache and results do not depend on threads.
//!
//! Where a pixel is not compared the target stands in for the render: the windows of SSIM around it
//! see an image that is right there, and it neither counts nor receives a derivative. Where the
//! camera did not see a colour the target is black, so that both images are what they are outside
//! the image: zero.

use super::blur::{CHANNELS, RADIUS, TAPS};
use super::{LossSettings, Target, l1, ssim::Ssim};
use crate::kernel::{Kernel, dispatch};
use fgs_geom::{Image, has_depth};
use rayon::prelude::*;

/// Rows of a strip: the rows of overlap cost about an eighth of the time, and an image of 480 rows
/// still occupies 10 threads.
const STRIP_ROWS: usize = 48;
/// Rows of the moments' derivatives that a strip needs.
const MOMENT_ROWS: usize = STRIP_ROWS + 2 * RADIUS;
/// Rows of the images that a strip needs.
const IMAGE_ROWS: usize = STRIP_ROWS + 4 * RADIUS;
/// Sums are kept in this many lanes, so that they vectorise and yet have a fixed order.
const LANES: usize = 16;

/// Means over valid pixels and channels, zero if there is none.
#[derive(Default)]
pub struct ColorLoss {
    pub l1: f64,
    /// Mean of `1 - SSIM`.
    pub dissimilarity: f64,
}

/// Both losses. The derivative of their weighted sum by the rendered colour goes to `d_color`.
pub fn color_loss(
    color: &Image<[f32; 3]>,
    target: &Target,
    settings: &LossSettings,
    d_color: &mut Image<[f32; 3]>,
) -> ColorLoss {
    let width = color.width();
    let pixels = target.compared_colors(settings);
    if pixels == 0 {
        d_color.data_mut().fill([0.0; 3]);
        return ColorLoss::default();
    }
    let count = (pixels * CHANNELS) as f64;
    let weights = Weights {
        l1: settings.l1_weight / count as f32,
        ssim: settings.ssim_weight / count as f32,
    };
    let sums: Vec<ColorLoss> = d_color
        .data_mut()
        .par_chunks_mut(STRIP_ROWS * width)
        .enumerate()
        .map_init(
            || Strip::new(width * CHANNELS),
            |strip, (index, d_color)| {
                dispatch(StripLoss {
                    strip,
                    color,
                    target,
                    masked: settings.mask_color_by_depth,
                    first_row: index * STRIP_ROWS,
                    weights: &weights,
                    d_color: d_color.as_flattened_mut(),
                })
            },
        )
        .collect();
    ColorLoss {
        l1: sums.iter().map(|s| s.l1).sum::<f64>() / count,
        dissimilarity: sums.iter().map(|s| s.dissimilarity).sum::<f64>() / count,
    }
}

/// Weights of the two losses, divided by the number of values.
struct Weights {
    l1: f32,
    ssim: f32,
}

/// The work on one strip, compiled for each instruction set.
struct StripLoss<'a> {
    strip: &'a mut Strip,
    color: &'a Image<[f32; 3]>,
    target: &'a Target,
    masked: bool,
    first_row: usize,
    weights: &'a Weights,
    d_color: &'a mut [f32],
}

impl Kernel for StripLoss<'_> {
    type Output = ColorLoss;

    #[inline(always)]
    fn run<const FUSED: bool, const WIDTH: usize>(self) -> ColorLoss {
        self.strip
            .load(self.color, self.target, self.masked, self.first_row);
        self.strip
            .differentiate::<FUSED>(self.weights, self.d_color)
    }
}

/// Buffers of one strip. Rows outside the image are zero and not valid.
struct Strip {
    row_len: usize,
    /// `render - target` and `render + target`.
    difference: Vec<f32>,
    sum: Vec<f32>,
    /// 1 where the pixel counts, else 0.
    valid: Vec<f32>,
    d_moments: [Vec<f32>; 3],
    error: Vec<f32>,
    ssim: Ssim,
}

impl Strip {
    fn new(row_len: usize) -> Self {
        let rows = |count: usize| vec![0.0; count * row_len];
        Self {
            row_len,
            difference: rows(IMAGE_ROWS),
            sum: rows(IMAGE_ROWS),
            valid: rows(IMAGE_ROWS),
            d_moments: std::array::from_fn(|_| rows(MOMENT_ROWS)),
            error: rows(1),
            ssim: Ssim::new(row_len),
        }
    }

    /// Fills the image rows for the strip that begins at row `first`.
    #[inline(always)]
    fn load(&mut self, color: &Image<[f32; 3]>, target: &Target, masked: bool, first: usize) {
        let n = self.row_len;
        for row in 0..IMAGE_ROWS {
            let span = row * n..(row + 1) * n;
            let difference = &mut self.difference[span.clone()];
            let sum = &mut self.sum[span.clone()];
            let valid = &mut self.valid[span];
            let v = (first + row).wrapping_sub(2 * RADIUS);
            if v >= color.height() {
                difference.fill(0.0);
                sum.fill(0.0);
                valid.fill(0.0);
                continue;
            }
            let pixels = valid.as_chunks_mut::<CHANNELS>().0;
            if masked {
                for (pixel, depth) in pixels.iter_mut().zip(target.depth_m.row(v)) {
                    *pixel = [f32::from(u8::from(has_depth(*depth))); CHANNELS];
                }
            } else {
                pixels.fill([1.0; CHANNELS]);
            }
            if let Some(seen) = &target.color_valid {
                for (pixel, seen) in pixels.iter_mut().zip(seen.row(v)) {
                    *pixel = pixel.map(|valid| if *seen { valid } else { 0.0 });
                }
            }
            let rendered = &color.row(v).as_flattened()[..n];
            let measured = &target.color.row(v).as_flattened()[..n];
            for i in 0..n {
                let measured = f32::from(measured[i]) / 255.0;
                difference[i] = valid[i] * (rendered[i] - measured);
                sum[i] = difference[i] + 2.0 * measured;
            }
        }
    }

    /// Sums of the two losses over the strip; their weighted derivatives go to `d_color`.
    #[inline(always)]
    fn differentiate<const FUSED: bool>(
        &mut self,
        weights: &Weights,
        d_color: &mut [f32],
    ) -> ColorLoss {
        let n = self.row_len;
        let Self {
            difference,
            sum,
            valid,
            d_moments,
            error,
            ssim,
            ..
        } = self;
        let own_rows = d_color.len() / n;
        let mut loss = ColorLoss::default();
        let [by_mean, by_dd, by_ss] = d_moments;
        for row in 0..own_rows + 2 * RADIUS {
            let moments = row * n..(row + 1) * n;
            ssim.forward::<FUSED>(
                window(difference, n, row),
                window(sum, n, row),
                &valid[(row + RADIUS) * n..][..n],
                error,
                [
                    &mut by_mean[moments.clone()],
                    &mut by_dd[moments.clone()],
                    &mut by_ss[moments],
                ],
            );
            if (RADIUS..RADIUS + own_rows).contains(&row) {
                loss.dissimilarity += sum_lanes(error);
            }
        }
        for (row, d_color) in d_color.chunks_exact_mut(n).enumerate() {
            let center = (row + 2 * RADIUS) * n..(row + 2 * RADIUS + 1) * n;
            let difference = &difference[center.clone()];
            let valid = &valid[center.clone()];
            ssim.backward::<FUSED>(
                [&*by_mean, &*by_dd, &*by_ss].map(|rows| window(rows, n, row)),
                difference,
                &sum[center],
                valid,
                d_color,
            );
            for d in d_color.iter_mut() {
                *d *= weights.ssim;
            }
            l1::l1(difference, valid, weights.l1, error, d_color);
            loss.l1 += sum_lanes(error);
        }
        loss
    }
}

/// [`TAPS`] rows of length `n`, from row `first`.
#[inline(always)]
fn window(rows: &[f32], n: usize, first: usize) -> [&[f32]; TAPS] {
    std::array::from_fn(|tap| &rows[(first + tap) * n..][..n])
}

#[inline(always)]
fn sum_lanes(values: &[f32]) -> f64 {
    let (blocks, rest) = values.as_chunks::<LANES>();
    let mut lanes = [0.0f32; LANES];
    for block in blocks {
        for (lane, value) in lanes.iter_mut().zip(block) {
            *lane += value;
        }
    }
    lanes.iter().chain(rest).map(|x| f64::from(*x)).sum()
}
