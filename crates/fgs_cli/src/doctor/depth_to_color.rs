//! Whether depth is registered to colour: depth discontinuities are object boundaries, which show as
//! colour edges at the same pixels.
//!
//! Input: some frames. The discontinuities are shifted, and stretched about the image's centre, to
//! where they coincide best with colour edges; in a registered recording that is where they already
//! are.

use fgs_geom::{Camera, Image, RgbdFrame, has_depth};
use nalgebra::{UnitQuaternion, Vector3};

use super::report::Check;
use super::sensor_offset::{EdgesAtDepth, sensor_offset};

const NAME: &str = "depth on colour";

/// Shifts are searched on images about this wide, where one pixel is two of 640.
const WORKING_WIDTH: usize = 320;

/// 24 of 640 pixels: an unregistered Kinect is off by 10 to 20.
const MAX_SHIFT: i32 = 12;

/// Stretches searched, per cent: the fields of view of colour and depth cameras differ by 5 to 20 %.
const STRETCHES: [i32; 13] = [-18, -15, -12, -9, -6, -3, 0, 3, 6, 9, 12, 15, 18];

/// Neighbouring depths with a larger relative difference are a discontinuity (*step* for short).
const MIN_STEP: f32 = 0.1;

/// Structured light leaves a shadow without depth beside a step, up to 20 of 640 pixels wide.
const MAX_SHADOW: usize = 10;

/// With fewer steps than this, nothing can be said.
const MIN_STEPS: usize = 2000;

/// Smallest shift that is reported, pixels of the working image; even good recordings are
/// calibrated only to a pixel or two of 640.
const MIN_SHIFT: f64 = 2.0;

/// To be reported, a shift must improve the agreement over that of random places by this factor, ...
const MIN_GAIN: f64 = 1.3;

/// ... and by this many standard errors, estimated from the scatter between frames.
const MIN_SIGNIFICANCE: f64 = 4.0;

/// Depth edges of consumer sensors are this far from where they should be, pixels.
const MAX_OFFSET_PX: f64 = 2.0;

const SIDE: usize = 2 * MAX_SHIFT as usize + 1;

/// Collects how well depth steps agree with colour edges, over frames.
#[derive(Default)]
pub struct EdgeMatcher {
    /// For each frame, the agreement at each (stretch, row shift, column shift).
    scores: Vec<Vec<f32>>,
    /// For each frame and mirror, the best agreement near its place.
    mirrored: Vec<[f32; MIRRORS.len()]>,
    /// For each frame, the edges of near and of far things at each shift.
    by_depth: Vec<[EdgesAtDepth; 2]>,
    steps: usize,
    /// Pixels of the recording per pixel of the working image.
    reduction: usize,
    camera: Option<Camera>,
}

/// A depth step between two pixels of the working image.
struct Step {
    u: f32,
    v: f32,
    is_vertical: bool,
    /// Of the nearer side.
    depth_m: f32,
}

type Mirror = fn(&Step, [f32; 2]) -> Step;

/// Ways to mirror a step in an image whose last pixel is given, and what they are called.
const MIRRORS: [(Mirror, &str); 3] = [
    (
        |step, [right, _]| Step {
            u: right - step.u,
            ..*step
        },
        "left to right",
    ),
    (
        |step, [_, bottom]| Step {
            v: bottom - step.v,
            ..*step
        },
        "top to bottom",
    ),
    (
        |step, [right, bottom]| Step {
            u: right - step.u,
            v: bottom - step.v,
            ..*step
        },
        "both ways (turned by half a turn)",
    ),
];

impl EdgeMatcher {
    /// Adds a frame.
    pub fn add(&mut self, frame: &RgbdFrame) {
        self.camera = Some(frame.camera);
        self.reduction = (frame.camera.width as f64 / WORKING_WIDTH as f64)
            .round()
            .max(1.0) as usize;
        let mut steps = steps(&frame.depth_m, self.reduction);
        if steps.is_empty() {
            return;
        }
        let luma = reduced_luma(&frame.color, self.reduction);
        let (horizontal, vertical) = (edges(&luma, 1, 0), edges(&luma, 0, 1));
        self.steps += steps.len();
        self.scores
            .push(agreement(&steps, &STRETCHES, &horizontal, &vertical));
        steps.sort_by(|a, b| a.depth_m.total_cmp(&b.depth_m));
        let (near, far) = steps.split_at(steps.len() / 2);
        self.by_depth.push([near, far].map(|steps| EdgesAtDepth {
            scores: agreement(steps, &[0], &horizontal, &vertical),
            lag: lag(steps),
            inverse_depth: mean(steps.iter().map(|step| 1.0 / f64::from(step.depth_m))),
        }));
        let size = [luma.width(), luma.height()].map(|size| size as f32 - 1.0);
        self.mirrored.push(MIRRORS.map(|(mirror, _)| {
            let turned: Vec<Step> = steps.iter().map(|step| mirror(step, size)).collect();
            let scores = agreement(&turned, &[0], &horizontal, &vertical);
            let near = (0..SIDE * SIDE).filter(|place| is_near(*place, 3));
            near.map(|place| scores[place]).fold(0.0, f32::max)
        }));
    }

    /// How depth has to be mirrored to fit colour, if it has to be.
    pub fn mirror(&self) -> Option<&'static str> {
        let best = |scores: &Vec<f32>| {
            let still = SIDE * SIDE * (STRETCHES.len() / 2);
            let near = (0..SIDE * SIDE).filter(|place| is_near(*place, 3));
            near.map(|place| scores[still + place]).fold(0.0, f32::max)
        };
        let random = self.random();
        MIRRORS.iter().enumerate().find_map(|(i, (_, name))| {
            let pairs = self.mirrored.iter().zip(&self.scores);
            let values: Vec<[f64; 2]> = pairs
                .map(|(mirrored, scores)| [mirrored[i], best(scores)].map(f64::from))
                .collect();
            let mean = |which: usize| {
                values.iter().map(|value| value[which]).sum::<f64>() / values.len() as f64
            };
            let gain = (mean(0) - random) / (mean(1) - random).max(1e-6);
            let differences: Vec<f64> = values.iter().map(|[a, b]| a - b).collect();
            (self.is_enough() && gain >= MIN_GAIN && significance(&differences) >= MIN_SIGNIFICANCE)
                .then_some(*name)
        })
    }

    fn is_enough(&self) -> bool {
        self.steps >= MIN_STEPS && self.scores.len() >= 3
    }

    /// The agreement at a random place.
    fn random(&self) -> f64 {
        let mean = |score: &Vec<f32>| {
            score.iter().map(|x| f64::from(*x)).sum::<f64>() / score.len() as f64
        };
        self.scores.iter().map(mean).sum::<f64>() / self.scores.len().max(1) as f64
    }

    /// The verdict over all frames.
    pub fn check(&self) -> Check {
        let Some(camera) = self.camera.filter(|_| self.is_enough()) else {
            let seen = "too few depth edges to compare with colour edges".into();
            return Check::unknown(NAME, seen);
        };
        if let Some(mirror) = self.mirror() {
            let seen = format!(
                "depth edges coincide with colour edges only if depth is mirrored {mirror}"
            );
            let advice = "mirror the depth images, or the colour images: one of the two is written \
                          the other way round";
            return Check::problem(NAME, seen, advice.into());
        }
        let n = self.scores.len() as f64;
        let places = STRETCHES.len() * SIDE * SIDE;
        let total: Vec<f64> = (0..places)
            .map(|i| {
                self.scores
                    .iter()
                    .map(|score| f64::from(score[i]))
                    .sum::<f64>()
                    / n
            })
            .collect();
        let best_of = |keep: &dyn Fn(usize) -> bool| {
            (0..places)
                .filter(|i| keep(*i))
                .max_by(|a, b| total[*a].total_cmp(&total[*b]))
        };
        let is_still = |place: usize| {
            let (stretch, du, dv) = shift_at(place);
            stretch == 0 && du.abs() <= 1 && dv.abs() <= 1
        };
        let (Some(best), Some(still)) = (best_of(&|_| true), best_of(&is_still)) else {
            return Check::unknown(NAME, "nothing to compare".into());
        };
        let random = total.iter().sum::<f64>() / places as f64;
        let gain = (total[best] - random) / (total[still] - random).max(1e-6);
        let differences: Vec<f64> = self
            .scores
            .iter()
            .map(|s| f64::from(s[best]) - f64::from(s[still]))
            .collect();
        let significance = significance(&differences);
        let (stretch, du, dv) = shift_at(best);
        // At the image's side edge, the shift that the stretch alone amounts to.
        let edge =
            f64::from(stretch.abs()) / 100.0 * 0.5 * camera.width as f64 / self.reduction as f64;
        let size = f64::from(du).hypot(f64::from(dv)).max(edge);
        if size < MIN_SHIFT || gain < MIN_GAIN || significance < MIN_SIGNIFICANCE {
            let over_random: Vec<f64> = self
                .scores
                .iter()
                .map(|s| f64::from(s[still]) - random)
                .collect();
            if self::significance(&over_random) < MIN_SIGNIFICANCE {
                let seen = "depth edges meet colour edges no more often than by chance".into();
                return Check::unknown(NAME, seen);
            }
            return self.judge_offset(&camera);
        }
        let px = |shift: i32| shift * self.reduction as i32;
        let stretched = match stretch {
            0 => String::new(),
            s => format!(" and stretched by {s} % about the centre"),
        };
        let seen = format!(
            "depth edges coincide with colour edges only if depth is moved by {:+} columns and \
             {:+} rows{stretched}",
            px(du),
            px(dv)
        );
        let advice = "register depth to the colour camera: record with the driver's aligned depth \
                      stream, or project depth into the colour image with the calibration of both";
        Check::problem(NAME, seen, advice.into())
    }

    /// The verdict where both images are of about the same camera.
    fn judge_offset(&self, camera: &Camera) -> Check {
        let seen = "depth edges coincide with colour edges".to_owned();
        let Some([found, errors]) = sensor_offset(&self.by_depth, camera, self.reduction) else {
            return Check::ok(NAME, seen);
        };
        let axis = |i: usize| (found.image_px[i], errors.image_px[i]);
        let turn = |i: usize| (found.turn_px[i], errors.turn_px[i]);
        let shift_mm = |i: usize| (1e3 * found.shift_m[i], 1e3 * errors.shift_m[i]);
        let measured = format!(
            "best if depth is moved by {} columns and {} rows; as a turn and a shift: {} and {} px, {} and \
             {} mm",
            with_error(axis(0)),
            with_error(axis(1)),
            with_error(turn(0)),
            with_error(turn(1)),
            with_error(shift_mm(0)),
            with_error(shift_mm(1))
        );
        let is_off = [axis(0), axis(1)]
            .iter()
            .any(|(px, error)| px.abs() >= MAX_OFFSET_PX.max(MIN_SIGNIFICANCE * error));
        if !is_off {
            return Check::ok(NAME, format!("{seen} ({measured})"));
        }
        let (k, [right, down]) = (camera.intrinsics, found.image_px);
        let turn = Vector3::new(-down / k.fy, right / k.fx, 0.0);
        let q = UnitQuaternion::from_scaled_axis(turn);
        let advice = format!(
            "set color_from_depth = [0.0, 0.0, 0.0, {:.5}, {:.5}, {:.5}, {:.5}] in the camera file",
            q.i, q.j, q.k, q.w
        );
        Check::warn(NAME, format!("{seen} {measured}"), advice)
    }
}

fn with_error((value, error): (f64, f64)) -> String {
    format!("{value:+.1} +- {error:.1}")
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1) as f64;
    values.sum::<f64>() / count
}

/// How far steps lie behind the pixels that they are looked up at, on average, columns and rows.
fn lag(steps: &[Step]) -> [f64; 2] {
    let behind = |is_vertical: bool| {
        let steps = steps.iter().filter(|step| step.is_vertical == is_vertical);
        let places = steps.map(|step| if is_vertical { step.v } else { step.u });
        let behind: Vec<f64> = places.map(|x| f64::from(x - looked_up(x))).collect();
        mean(behind.into_iter())
    };
    [behind(false), behind(true)]
}

/// A step between two pixels is an edge at both. Always the lower one (rounding goes up), or rows and
/// columns would be biased.
fn looked_up(x: f32) -> f32 {
    (x - 0.25).round()
}

/// Mean over its standard error, of values of independent frames.
fn significance(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
    mean / (variance / n).sqrt().max(1e-9)
}

/// Whether a place of one stretch is that of a shift of at most so many pixels.
fn is_near(place: usize, px: i32) -> bool {
    let (_, du, dv) = shift_at(place);
    du.abs() <= px && dv.abs() <= px
}

fn shift_at(place: usize) -> (i32, i32, i32) {
    let shift = |i: usize| i as i32 - MAX_SHIFT;
    let (stretch, rest) = (place / (SIDE * SIDE), place % (SIDE * SIDE));
    (STRETCHES[stretch], shift(rest % SIDE), shift(rest / SIDE))
}

/// The mean strength of the colour edges at the steps, for each stretch and shift.
fn agreement(
    steps: &[Step],
    stretches: &[i32],
    horizontal: &Image<f32>,
    vertical: &Image<f32>,
) -> Vec<f32> {
    let center = [horizontal.width(), horizontal.height()].map(|size| 0.5 * (size as f32 - 1.0));
    let mut scores = Vec::with_capacity(stretches.len() * SIDE * SIDE);
    for stretch in stretches {
        let factor = 1.0 + *stretch as f32 / 100.0;
        let mut sums = [0f32; SIDE * SIDE];
        let mut counts = [0u32; SIDE * SIDE];
        for step in steps {
            let edges = if step.is_vertical {
                vertical
            } else {
                horizontal
            };
            let pixel = |x: f32, c: f32| looked_up(c + factor * (x - c)) as i32;
            let (u, v) = (pixel(step.u, center[0]), pixel(step.v, center[1]));
            for dv in -MAX_SHIFT..=MAX_SHIFT {
                let row = v + dv;
                if !(0..edges.height() as i32).contains(&row) {
                    continue;
                }
                let row = edges.row(row as usize);
                let first = (dv + MAX_SHIFT) as usize * SIDE;
                for du in -MAX_SHIFT..=MAX_SHIFT {
                    if let Some(edge) = usize::try_from(u + du).ok().and_then(|u| row.get(u)) {
                        let place = first + (du + MAX_SHIFT) as usize;
                        sums[place] += edge;
                        counts[place] += 1;
                    }
                }
            }
        }
        scores.extend(
            sums.iter()
                .zip(counts)
                .map(|(sum, count)| sum / count.max(1) as f32),
        );
    }
    scores
}

/// Steps between horizontal and vertical neighbours, at the border of the nearer object.
fn steps(depth_m: &Image<f32>, reduction: usize) -> Vec<Step> {
    let (width, height) = (depth_m.width(), depth_m.height());
    let mut steps = Vec::new();
    let to_working = |x: f32| (x + 0.5) / reduction as f32 - 0.5;
    // Lines every `reduction` pixels are as dense as the working image.
    for v in (0..height).step_by(reduction) {
        along(
            width,
            |u| depth_m.at(u, v),
            |u, depth_m| {
                steps.push(Step {
                    u: to_working(u),
                    v: to_working(v as f32),
                    is_vertical: false,
                    depth_m,
                });
            },
        );
    }
    for u in (0..width).step_by(reduction) {
        along(
            height,
            |v| depth_m.at(u, v),
            |v, depth_m| {
                steps.push(Step {
                    u: to_working(u as f32),
                    v: to_working(v),
                    is_vertical: true,
                    depth_m,
                });
            },
        );
    }
    steps
}

/// Calls `found` with the position of each step on a line of pixels, and the depth of its nearer side.
fn along(len: usize, depth_at: impl Fn(usize) -> f32, mut found: impl FnMut(f32, f32)) {
    let mut last: Option<(usize, f32)> = None;
    for place in 0..len {
        let depth = depth_at(place);
        if !has_depth(depth) {
            continue;
        }
        if let Some((last_place, last_depth)) = last
            && place - last_place <= MAX_SHADOW
            && (depth - last_depth).abs() > MIN_STEP * depth.min(last_depth)
        {
            let nearer_ends = last_depth < depth;
            let border = if nearer_ends {
                last_place as f32 + 0.5
            } else {
                place as f32 - 0.5
            };
            found(border, depth.min(last_depth));
        }
        last = Some((place, depth));
    }
}

/// Edge strength along one direction, 0 to 1; one half where the gradient is twice the image's mean.
fn edges(luma: &Image<f32>, du: usize, dv: usize) -> Image<f32> {
    let slope = Image::from_fn(luma.width(), luma.height(), |u, v| {
        let ahead = luma.at(
            (u + du).min(luma.width() - 1),
            (v + dv).min(luma.height() - 1),
        );
        (ahead - luma.at(u.saturating_sub(du), v.saturating_sub(dv))).abs()
    });
    let mean = slope.data().iter().sum::<f32>() / slope.data().len() as f32;
    let half = (2.0 * mean).max(1e-3);
    slope.map(|slope| slope / (slope + half))
}

fn reduced_luma(color: &Image<[u8; 3]>, reduction: usize) -> Image<f32> {
    Image::from_fn(
        color.width() / reduction,
        color.height() / reduction,
        |u, v| {
            let rows = v * reduction..(v + 1) * reduction;
            let pixels = rows.flat_map(|row| &color.row(row)[u * reduction..(u + 1) * reduction]);
            let sum: f32 = pixels
                .map(|rgb| rgb.iter().map(|c| f32::from(*c)).sum::<f32>())
                .sum();
            sum / (3 * reduction * reduction) as f32
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::report::Verdict;
    use crate::doctor::test_room;

    /// Depth of pixel (u, v) is taken from `source(u, v)`.
    fn check_with(source: impl Fn(f32, f32) -> (f32, f32)) -> Check {
        let mut matcher = EdgeMatcher::default();
        for i in 0..24 {
            let mut frame = test_room::frame(3 * i);
            let depth_m = &frame.depth_m;
            frame.depth_m = Image::from_fn(depth_m.width(), depth_m.height(), |u, v| {
                let (u, v) = source(u as f32, v as f32);
                let inside = u >= 0.0 && v >= 0.0;
                inside
                    .then(|| depth_m.get(u as usize, v as usize))
                    .flatten()
                    .unwrap_or(0.0)
            });
            matcher.add(&frame);
        }
        matcher.check()
    }

    #[test]
    fn registered_depth_is_left_alone() {
        assert_eq!(check_with(|u, v| (u, v)).verdict, Verdict::Ok);
        assert_eq!(check_with(|u, v| (u + 1.0, v)).verdict, Verdict::Ok);
        assert_eq!(EdgeMatcher::default().check().verdict, Verdict::Unknown);
    }

    #[test]
    fn shifts_and_stretches_are_named() {
        let moved = check_with(|u, v| (u - 7.0, v + 4.0));
        assert_eq!(moved.verdict, Verdict::Problem, "{}", moved.seen);
        let names_shift = ["-6", "-7", "-8"]
            .iter()
            .any(|du| moved.seen.contains(&format!("{du} columns")));
        assert!(names_shift, "{}", moved.seen);
        let stretched = check_with(|u, v| (108.0 + (u - 108.0) / 1.1, 80.0 + (v - 80.0) / 1.1));
        assert_eq!(stretched.verdict, Verdict::Problem, "{}", stretched.seen);
        assert!(
            stretched.seen.contains("stretched by -9 %"),
            "{}",
            stretched.seen
        );
    }

    #[test]
    fn a_shadow_does_not_hide_a_step() {
        let line = [1.0, 1.0, 0.0, 0.0, 2.0, 2.0, f32::NAN, 0.9];
        let mut places = Vec::new();
        along(
            line.len(),
            |i| line[i],
            |place, depth| places.push((place, depth)),
        );
        assert_eq!(places, [(1.5, 1.0), (6.5, 0.9)]);
    }
}
