//! Pairs of frames with motion between them, registered by geometry alone.
//!
//! Input: frames in order. Each is registered to the first frame of the current pair, starting from
//! the motion so far, until the views overlap too little or the pair gets too long; the last frame
//! that could be registered ends the pair and starts the next.
//! Invariant: distances are measured in units of the scene's depth, so a wrong depth scale changes
//! only the lengths of the translations.

use fgs_geom::{Camera, FrameIndex, Image, RgbdFrame, Se3};
use fgs_gicp::{Alignment, DepthGrid, Kernel, MIN_EIGENVALUE, Point, PointMap, Settings, align};

use super::statistics::median_depth;

/// Grid points per frame: enough to determine six degrees of freedom to a small fraction of a pixel.
pub const GRID_POINTS: f64 = 3000.0;

/// Smallest inlier ratio: below it, a frame overlaps the pair's first one too little to tell a failed
/// registration from a different view.
const MIN_INLIER_SHARE: f64 = 0.7;

/// Smallest conditioning; below it the view can slide along a plane: a single wall gives 1e-3.
const MIN_CONDITIONING: f64 = 2e-3;

/// Longest pair, in frames: one second at the usual 30 Hz, in which a hand moves by 20 cm and 10
/// degrees, a hundred times the registration's error.
const MAX_PAIR_FRAMES: usize = 30;

/// Scenes are scaled so that the median depth of a pair's first frame is this, metres: the distances
/// in [`settings`] are chosen for rooms.
const WORKING_DEPTH_M: f32 = 2.0;

/// Two frames and the motion between them.
pub struct FramePair {
    /// The earlier frame.
    pub first: Side,
    /// The later frame.
    pub second: Side,
    /// The registered motion, in the metres of the recording's depth.
    pub first_from_second: Se3,
    /// Median depth of the first frame, in the metres of the recording's depth.
    pub median_depth_m: f64,
}

/// What is kept of a frame.
#[derive(Clone)]
pub struct Side {
    /// Seconds on the recording's clock.
    pub timestamp_secs: f64,
    /// Depth, in the metres of the recording.
    pub depth_m: Image<f32>,
    /// Brightness, 0 to 255.
    pub luma: Image<f32>,
}

/// Forms pairs from the frames it is given.
pub struct PairBuilder {
    camera: Camera,
    open: Option<OpenPair>,
    /// The pairs so far.
    pub pairs: Vec<FramePair>,
    /// Frames that could not be registered to the one before.
    pub lost: Vec<FrameIndex>,
}

/// A pair that may still grow.
struct OpenPair {
    first: Side,
    /// Metres of the recording per metre of the registration.
    unit: f32,
    target: PointMap,
    frames: usize,
    /// The last frame that could be registered.
    last: Option<Side>,
    first_from_last: Se3,
    previous_from_last: Se3,
}

impl PairBuilder {
    /// For frames of this camera.
    pub fn new(camera: Camera) -> Self {
        Self {
            camera,
            open: None,
            pairs: Vec::new(),
            lost: Vec::new(),
        }
    }

    /// Says that the next frame does not directly follow the last one: ends the pair.
    pub fn interrupt(&mut self) {
        self.pairs
            .extend(self.open.take().and_then(|open| open.close().0));
    }

    /// Adds the next frame.
    pub fn add(&mut self, frame: &RgbdFrame) {
        let Some(mut open) = self.open.take() else {
            self.open = OpenPair::new(Side::new(frame), &self.camera);
            return;
        };
        let fits = open.extend(frame, &self.camera);
        if fits && open.frames < MAX_PAIR_FRAMES {
            self.open = Some(open);
            return;
        }
        let is_first_step = open.last.is_none();
        let (pair, last) = open.close();
        self.pairs.extend(pair);
        self.open = OpenPair::new(last, &self.camera);
        if fits {
            return;
        }
        // Seen from the frame before, it may fit; if that was the pair's first, it has been tried.
        let fits_now = !is_first_step
            && self
                .open
                .as_mut()
                .is_some_and(|open| open.extend(frame, &self.camera));
        if !fits_now {
            self.lost.push(frame.index);
            self.open = OpenPair::new(Side::new(frame), &self.camera);
        }
    }
}

impl OpenPair {
    /// `None` if the frame has no surfaces to register to.
    fn new(first: Side, camera: &Camera) -> Option<Self> {
        let unit = median_depth(&first.depth_m)? / WORKING_DEPTH_M;
        let mut target = PointMap::new(settings().max_correspondence_distance_m);
        for (id, point) in points(&first.depth_m, camera, unit).into_iter().enumerate() {
            target.insert(id as u64, point);
        }
        (!target.is_empty()).then(|| Self {
            first,
            unit,
            target,
            frames: 1,
            last: None,
            first_from_last: Se3::identity(),
            previous_from_last: Se3::identity(),
        })
    }

    /// Whether the frame can be registered; if so, it becomes the pair's last.
    fn extend(&mut self, frame: &RgbdFrame, camera: &Camera) -> bool {
        let source = points(&frame.depth_m, camera, self.unit);
        let start = self.first_from_last * self.previous_from_last;
        let fits = |alignment: &Alignment| {
            alignment.converged
                && alignment.inlier_share >= MIN_INLIER_SHARE
                && alignment.conditioning.weakest >= MIN_CONDITIONING
        };
        let Some(alignment) = align(&source, &self.target, &start, &settings())
            .ok()
            .filter(fits)
        else {
            return false;
        };
        self.previous_from_last = self.first_from_last.inverse() * alignment.target_from_source;
        self.first_from_last = alignment.target_from_source;
        self.frames += 1;
        self.last = Some(Side::new(frame));
        true
    }

    /// The pair, if it has a second frame, and the frame that ends it.
    fn close(self) -> (Option<FramePair>, Side) {
        let Some(second) = self.last else {
            return (None, self.first);
        };
        let unit = f64::from(self.unit);
        let Se3 {
            rotation,
            translation,
        } = self.first_from_last;
        let pair = FramePair {
            first: self.first,
            second: second.clone(),
            first_from_second: Se3::new(rotation, translation * unit),
            median_depth_m: unit * f64::from(WORKING_DEPTH_M),
        };
        (Some(pair), second)
    }
}

impl Side {
    fn new(frame: &RgbdFrame) -> Self {
        // Luma of BT.601.
        let luma = |rgb: &[u8; 3]| {
            let [r, g, b] = rgb.map(f32::from);
            0.299 * r + 0.587 * g + 0.114 * b
        };
        Self {
            timestamp_secs: frame.timestamp_secs,
            depth_m: frame.depth_m.clone(),
            luma: frame.color.map(luma),
        }
    }
}

/// At [`WORKING_DEPTH_M`], 3 cm are 8 pixels, more than the error of prediction and noise together.
/// The robust kernel's centimetre is twice the noise there.
fn settings() -> Settings {
    Settings {
        max_correspondence_distance_m: 0.06,
        kernel: Kernel::Cauchy { scale_m: 0.01 },
        rotation_epsilon_rad: 2e-4,
        translation_epsilon_m: 2e-4,
        ..Settings::default()
    }
}

fn points(depth_m: &Image<f32>, camera: &Camera, unit: f32) -> Vec<Point> {
    let depth = depth_m.map(|depth| depth / unit);
    grid(camera)
        .surface_points(&depth, camera)
        .iter()
        .map(|point| point.disk(MIN_EIGENVALUE, 0.0))
        .collect()
}

/// A grid of about [`GRID_POINTS`] pixels over the whole image.
pub fn grid(camera: &Camera) -> DepthGrid {
    let pixels = (camera.width * camera.height) as f64;
    DepthGrid {
        stride_px: (pixels / GRID_POINTS).sqrt().ceil() as usize,
        ..DepthGrid::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::test_room;

    fn pairs_of(frames: impl Iterator<Item = RgbdFrame>) -> PairBuilder {
        let mut builder = PairBuilder::new(test_room::camera());
        frames.for_each(|frame| builder.add(&frame));
        builder.interrupt();
        builder
    }

    fn index(side: &Side) -> usize {
        (side.timestamp_secs * 30.0).round() as usize
    }

    #[test]
    fn motions_are_the_true_ones_in_the_recordings_unit() {
        for unit in [1.0, 5.0] {
            let scaled = |mut frame: RgbdFrame| {
                frame.depth_m = frame.depth_m.map(|depth| depth * unit);
                frame
            };
            let built = pairs_of((0..60).map(test_room::frame).map(scaled));
            assert!(built.lost.is_empty());
            assert!(built.pairs.len() >= 2);
            assert_eq!(index(&built.pairs[0].first), 0);
            assert_eq!(index(&built.pairs[built.pairs.len() - 1].second), 59);
            for pair in &built.pairs {
                let [first, second] =
                    [&pair.first, &pair.second].map(|s| test_room::world_from_camera(index(s)));
                let mut truth = first.inverse() * second;
                truth.translation *= f64::from(unit);
                let error = (truth.inverse() * pair.first_from_second).log();
                let size = truth.log();
                assert!(error.norm() <= 0.02 * size.norm(), "{error} {size}");
            }
        }
    }

    #[test]
    fn a_jump_to_another_place_is_a_lost_frame() {
        let frames = (0..10).chain(80..90).map(test_room::frame);
        let built = pairs_of(frames);
        assert_eq!(built.lost, [FrameIndex(80)]);
        assert_eq!(built.pairs.len(), 2);
        assert_eq!(index(&built.pairs[1].first), 80);
    }

    #[test]
    fn frames_without_depth_are_survived() {
        let blank = |mut frame: RgbdFrame| {
            frame.depth_m = frame.depth_m.map(|_| 0.0);
            frame
        };
        let built = pairs_of((0..5).map(test_room::frame).map(blank));
        assert!(built.pairs.is_empty());
        let frames = (0..10).map(|i| {
            if i == 5 {
                blank(test_room::frame(i))
            } else {
                test_room::frame(i)
            }
        });
        assert_eq!(pairs_of(frames).lost, [FrameIndex(5)]);
    }
}
