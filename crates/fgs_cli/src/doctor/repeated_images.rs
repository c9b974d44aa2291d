//! Whether images come twice: a recorder that asks a camera for its newest images faster than it takes
//! them gets some again, of one sensor or of both.

use fgs_geom::{Image, RgbdFrame, has_depth};

use super::report::Check;

const NAME: &str = "repeated images";

/// Compares each frame's images with those before. Real sensors have noise: no two images are equal.
#[derive(Default)]
pub struct RepeatWatch {
    previous: Option<(Image<[u8; 3]>, Image<f32>)>,
    compared: usize,
    colors: usize,
    depths: usize,
}

impl RepeatWatch {
    /// Says that the next frame does not directly follow the last one.
    pub fn interrupt(&mut self) {
        self.previous = None;
    }

    /// Adds the next frame.
    pub fn add(&mut self, frame: &RgbdFrame) {
        if let Some((color, depth_m)) = &self.previous {
            self.compared += 1;
            // What never changes is a sensor that is off or missing.
            let color_repeats = *color == frame.color && !is_blank(color);
            let depth_repeats =
                *depth_m == frame.depth_m && depth_m.data().iter().any(|d| has_depth(*d));
            self.colors += usize::from(color_repeats);
            self.depths += usize::from(depth_repeats);
        }
        self.previous = Some((frame.color.clone(), frame.depth_m.clone()));
    }

    /// The verdict over all frames.
    pub fn check(&self) -> Check {
        let Self {
            compared,
            colors,
            depths,
            ..
        } = *self;
        if compared == 0 {
            return Check::unknown(NAME, "no two consecutive frames could be read".into());
        }
        if colors + depths == 0 {
            return Check::ok(NAME, format!("none of {compared} equals the one before"));
        }
        let percent = |count: usize| 100.0 * count as f64 / compared as f64;
        Check::warn(
            NAME,
            format!(
                "equal to the one before are {colors} of {compared} colour images ({:.0} %) and {depths} of \
                 {compared} depth images ({:.0} %)",
                percent(colors),
                percent(depths)
            ),
            "the recorder asked for images faster than the camera took them, so their time stamps are off by \
             up to a frame; a run recognises such images and evens stamps out, but record at the camera's \
             own rate"
                .into(),
        )
    }
}

/// Whether an image shows nothing.
fn is_blank(color: &Image<[u8; 3]>) -> bool {
    color.data().windows(2).all(|pair| pair[0] == pair[1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::report::Verdict;
    use crate::doctor::test_room;

    /// Two sensors that take new images at these frames.
    fn check(color: impl Fn(usize) -> usize, depth: impl Fn(usize) -> usize) -> Check {
        let mut watch = RepeatWatch::default();
        for index in 0..11 {
            let mut frame = test_room::frame(color(index));
            frame.depth_m = test_room::frame(depth(index)).depth_m;
            watch.add(&frame);
        }
        watch.check()
    }

    /// Of 24 Hz, asked at 30.
    fn slow(index: usize) -> usize {
        index * 24 / 30
    }

    #[test]
    fn each_sensor_is_counted() {
        assert_eq!(check(|i| i, |i| i).verdict, Verdict::Ok);
        let color = check(slow, |i| i);
        assert_eq!(color.verdict, Verdict::Warn);
        let seen = "equal to the one before are 2 of 10 colour images (20 %) and 0 of 10 depth images (0 %)";
        assert_eq!(color.seen, seen);
        let depth = check(|i| i, slow);
        assert!(
            depth.seen.contains("0 of 10 colour images")
                && depth.seen.contains("2 of 10 depth images")
        );
    }

    #[test]
    fn a_gap_and_a_sensor_that_is_off_are_no_repetitions() {
        let mut watch = RepeatWatch::default();
        assert_eq!(watch.check().verdict, Verdict::Unknown);
        watch.add(&test_room::frame(0));
        watch.interrupt();
        watch.add(&test_room::frame(0));
        assert_eq!(watch.check().verdict, Verdict::Unknown);
        for index in 1..3 {
            let mut frame = test_room::frame(index);
            frame.color = frame.color.map(|_| [0; 3]);
            frame.depth_m = frame.depth_m.map(|_| 0.0);
            watch.add(&frame);
        }
        assert_eq!(watch.check().verdict, Verdict::Ok);
    }
}
