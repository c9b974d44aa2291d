//! L1 and SSIM of the rendered colour.
//!
//! Input: rendered colour and the target. Output: both means over the valid pixels, and the
//! derivative of their weighted sum. Strips of rows are processed independently, so that results
//! do not depend on the number of threads. Each strip streams through its rows, plus the 10 above
//! and below that its derivatives depend on; ring buffers of 11 rows hold what the windows need and
//! stay in the cache.
//!
//! At a pixel that is not compared the render is replaced by the target: SSIM's windows see no
//! error there, and the pixel neither counts nor gets a derivative. Where the camera saw no colour
//! the target is black, so that both images are zero, as outside the image.

use super::blur::{CHANNELS, RADIUS, TAPS};
use super::l1::{l1, sum_lanes};
use super::{LossSettings, Target, ssim::Ssim};
use crate::kernel::{Kernel, dispatch};
use fgs_geom::{Image, has_depth};
use rayon::prelude::*;

/// Rows per strip: the overlap costs about a fifth of the time, and 480 rows still make 8 tasks.
const STRIP_ROWS: usize = 60;

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
        let own_rows = self.d_color.len() / self.strip.row_len;
        let mut loss = ColorLoss::default();
        // Rows count from the first that the strip's derivatives depend on.
        for row in 0..own_rows + 4 * RADIUS {
            let v = (self.first_row + row).wrapping_sub(2 * RADIUS);
            self.strip
                .load_row(row, v, self.color, self.target, self.masked);
            let Some(moments_row) = row.checked_sub(2 * RADIUS) else {
                continue;
            };
            let dissimilarity = self.strip.compare_row::<FUSED>(moments_row);
            if (RADIUS..RADIUS + own_rows).contains(&moments_row) {
                loss.dissimilarity += dissimilarity;
            }
            let Some(own_row) = moments_row.checked_sub(2 * RADIUS) else {
                continue;
            };
            let n = self.strip.row_len;
            let d_color = &mut self.d_color[own_row * n..][..n];
            loss.l1 += self
                .strip
                .differentiate_row::<FUSED>(own_row, self.weights, d_color);
        }
        loss
    }
}

/// Rings of a strip's last [`TAPS`] rows: row `r` has place `r % TAPS`. Rows outside the image are
/// zero and not valid.
struct Strip {
    row_len: usize,
    /// `render - target` and `render + target`.
    difference: Vec<f32>,
    sum: Vec<f32>,
    /// 1 where the pixel counts, else 0.
    valid: Vec<f32>,
    /// Row `r` is where the window's first row is `r`.
    d_moments: [Vec<f32>; 3],
    /// One row.
    error: Vec<f32>,
    ssim: Ssim,
}

impl Strip {
    fn new(row_len: usize) -> Self {
        let ring = || vec![0.0; TAPS * row_len];
        Self {
            row_len,
            difference: ring(),
            sum: ring(),
            valid: ring(),
            d_moments: std::array::from_fn(|_| ring()),
            error: vec![0.0; row_len],
            ssim: Ssim::new(row_len),
        }
    }

    /// Fills row `row` with row `v` of the images.
    #[inline(always)]
    fn load_row(
        &mut self,
        row: usize,
        v: usize,
        color: &Image<[f32; 3]>,
        target: &Target,
        masked: bool,
    ) {
        let n = self.row_len;
        let difference = row_mut(&mut self.difference, n, row);
        let sum = row_mut(&mut self.sum, n, row);
        let valid = row_mut(&mut self.valid, n, row);
        if v >= color.height() {
            difference.fill(0.0);
            sum.fill(0.0);
            valid.fill(0.0);
            return;
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

    /// Fills row `first` of `d_moments` from the rows from there on. The sum of `1 - SSIM`.
    #[inline(always)]
    fn compare_row<const FUSED: bool>(&mut self, first: usize) -> f64 {
        let n = self.row_len;
        let [by_mean, by_dd, by_ss] = &mut self.d_moments;
        self.ssim.forward::<FUSED>(
            window(&self.difference, n, first),
            window(&self.sum, n, first),
            row(&self.valid, n, first + RADIUS),
            &mut self.error,
            [
                row_mut(by_mean, n, first),
                row_mut(by_dd, n, first),
                row_mut(by_ss, n, first),
            ],
        );
        sum_lanes(&self.error)
    }

    /// The weighted derivatives of both losses by the row whose windows' moments begin at row
    /// `first`. The sum of its absolute errors.
    #[inline(always)]
    fn differentiate_row<const FUSED: bool>(
        &mut self,
        first: usize,
        weights: &Weights,
        d_color: &mut [f32],
    ) -> f64 {
        let n = self.row_len;
        let center = first + 2 * RADIUS;
        let difference = row(&self.difference, n, center);
        let valid = row(&self.valid, n, center);
        let [by_mean, by_dd, by_ss] = &self.d_moments;
        self.ssim.backward::<FUSED>(
            [by_mean, by_dd, by_ss].map(|rows| window(rows, n, first)),
            difference,
            row(&self.sum, n, center),
            valid,
            d_color,
        );
        for d in d_color.iter_mut() {
            *d *= weights.ssim;
        }
        l1(difference, valid, weights.l1, &mut self.error, d_color);
        sum_lanes(&self.error)
    }
}

#[inline(always)]
fn row(ring: &[f32], n: usize, row: usize) -> &[f32] {
    &ring[row % TAPS * n..][..n]
}

#[inline(always)]
fn row_mut(ring: &mut [f32], n: usize, row: usize) -> &mut [f32] {
    &mut ring[row % TAPS * n..][..n]
}

/// [`TAPS`] rows of length `n`, from row `first`.
#[inline(always)]
fn window(ring: &[f32], n: usize, first: usize) -> [&[f32]; TAPS] {
    std::array::from_fn(|tap| row(ring, n, first + tap))
}
