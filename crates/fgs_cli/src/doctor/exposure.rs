//! Whether brightness jumps from one frame to the next. Tracking uses geometry and does not mind, but
//! one map cannot show two brightnesses.

use fgs_geom::{FrameIndex, Image};

use super::report::Check;
use super::statistics::median;

const NAME: &str = "exposure";

/// Blocks with sides of this many pixels are compared: between frames, objects move by less.
const BLOCK_PX: usize = 16;

/// A change of brightness that is visible: 10 %.
const MIN_JUMP: f64 = 0.1;

/// Blocks darker or brighter than this are clipped and are ignored.
const USABLE: std::ops::RangeInclusive<f64> = 10.0..=245.0;

/// Follows brightness from frame to frame.
#[derive(Default)]
pub struct ExposureWatch {
    previous: Vec<f64>,
    frames: usize,
    /// Frames in which nothing can be seen.
    clipped: usize,
    steps: Vec<(FrameIndex, f64)>,
}

impl ExposureWatch {
    /// Says that the next frame does not directly follow the last one.
    pub fn interrupt(&mut self) {
        self.previous.clear();
    }

    /// Adds the next frame.
    pub fn add(&mut self, index: FrameIndex, color: &Image<[u8; 3]>) {
        let blocks = block_means(color);
        self.frames += 1;
        self.clipped += usize::from(!blocks.iter().any(|block| USABLE.contains(block)));
        let is_usable =
            |(before, after): &(&f64, &f64)| USABLE.contains(*before) && USABLE.contains(*after);
        let both = self.previous.iter().zip(&blocks).filter(is_usable);
        let ratios = both.map(|(before, after)| (after / before).ln());
        if let Some(step) = median(ratios.collect()) {
            self.steps.push((index, step));
        }
        self.previous = blocks;
    }

    /// The verdict over all frames.
    pub fn check(&self) -> Check {
        let jumps = || self.steps.iter().filter(|(_, step)| step.abs() >= MIN_JUMP);
        let largest = self
            .steps
            .iter()
            .max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
        if 2 * self.clipped > self.frames {
            let seen = format!(
                "{} of {} colour images are black or white all over",
                self.clipped, self.frames
            );
            let advice = "record colour with enough light, lens uncovered; without it there is no map \
                          worth seeing";
            return Check::problem(NAME, seen, advice.into());
        }
        let Some((index, step)) = largest else {
            return Check::unknown(NAME, "no two consecutive frames could be read".into());
        };
        let percent = 100.0 * (step.exp() - 1.0);
        match jumps().count() {
            0 => Check::ok(
                NAME,
                format!(
                    "brightness changes by {:.1} % a frame at most",
                    percent.abs()
                ),
            ),
            count => Check::warn(
                NAME,
                format!(
                    "jumps of brightness: {count}; the largest is {percent:+.0} % at frame {}",
                    index.0
                ),
                "lock exposure and white balance while recording".into(),
            ),
        }
    }
}

fn block_means(color: &Image<[u8; 3]>) -> Vec<f64> {
    let mut means = Vec::new();
    for v in (0..color.height()).step_by(BLOCK_PX) {
        for u in (0..color.width()).step_by(BLOCK_PX) {
            let columns = u..(u + BLOCK_PX).min(color.width());
            let rows = v..(v + BLOCK_PX).min(color.height());
            let count = columns.len() * rows.len() * 3;
            let sum: u32 = rows
                .flat_map(|row| color.row(row)[columns.clone()].as_flattened())
                .map(|channel| u32::from(*channel))
                .sum();
            means.push(f64::from(sum) / count as f64);
        }
    }
    means
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::report::Verdict;

    /// An image shifted by `shift` pixels and scaled in brightness.
    fn picture(shift: usize, light: f64) -> Image<[u8; 3]> {
        Image::from_fn(160, 96, |u, v| {
            let value = 100.0 + 60.0 * (((u + shift) as f64) / 9.0).sin() * (v as f64 / 7.0).cos();
            [(light * value).round().min(255.0) as u8; 3]
        })
    }

    fn check(lights: &[f64]) -> Check {
        let mut watch = ExposureWatch::default();
        for (i, light) in lights.iter().enumerate() {
            watch.add(FrameIndex(i), &picture(i, *light));
        }
        watch.check()
    }

    #[test]
    fn a_jump_is_named_and_drift_is_not() {
        assert_eq!(check(&[1.0, 1.03, 1.06, 1.09]).verdict, Verdict::Ok);
        let jump = check(&[1.0, 1.0, 0.8, 0.8]);
        assert_eq!(jump.verdict, Verdict::Warn);
        assert_eq!(
            jump.seen,
            "jumps of brightness: 1; the largest is -20 % at frame 2"
        );
        assert_eq!(check(&[1.0]).verdict, Verdict::Unknown);
    }

    #[test]
    fn frames_apart_are_not_compared() {
        let mut watch = ExposureWatch::default();
        watch.add(FrameIndex(0), &picture(0, 1.0));
        watch.interrupt();
        watch.add(FrameIndex(50), &picture(3, 0.7));
        watch.add(FrameIndex(51), &picture(4, 0.7));
        assert_eq!(watch.check().verdict, Verdict::Ok);
    }
}
