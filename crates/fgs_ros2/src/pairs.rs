//! Colour and depth images on their way in: which were taken together?
//!
//! They are paired as those of a bag are, by [`associate`], but without waiting for the end: a pair is given
//! away as soon as nothing that is still to come can be nearer.

use std::collections::VecDeque;

use fgs_data::{OpenOptions, associate};

/// So many images of either kind wait for their partner: a quarter of a second at 30 a second.
const WAITING: usize = 8;

/// Images taken so little apart belong together, whatever comes: no camera takes more than a hundred a
/// second.
const SURE_SECS: f64 = 0.005;

/// A message and when it was measured, seconds.
#[derive(Debug, PartialEq)]
pub(crate) struct Stamped {
    pub secs: f64,
    pub message: Vec<u8>,
}

/// The images that wait.
#[derive(Debug, Default)]
pub(crate) struct Pairs {
    color: VecDeque<Stamped>,
    depth: VecDeque<Stamped>,
    /// When the last pair was taken.
    last: Option<[f64; 2]>,
}

impl Pairs {
    pub fn add_color(&mut self, image: Stamped) {
        add(&mut self.color, image, self.last.map(|[color, _]| color));
    }

    pub fn add_depth(&mut self, image: Stamped) {
        add(&mut self.depth, image, self.last.map(|[_, depth]| depth));
    }

    /// The oldest pair, colour first. What is older than it is forgotten.
    pub fn next(&mut self) -> Option<[Stamped; 2]> {
        let secs = |images: &VecDeque<Stamped>| images.iter().map(|i| i.secs).collect::<Vec<_>>();
        let most = OpenOptions::default().max_time_difference_secs;
        let pairs = associate(&secs(&self.color), &secs(&self.depth), most);
        let &(color, depth) = pairs.first()?;
        let times = [self.color[color].secs, self.depth[depth].secs];
        let is_final = (times[0] - times[1]).abs() <= SURE_SECS
            || self.depth.back()?.secs >= times[0] && self.color.back()?.secs >= times[1];
        if !is_final {
            return None;
        }
        self.last = Some(times);
        let color = self.color.drain(..=color).next_back()?;
        let depth = self.depth.drain(..=depth).next_back()?;
        Some([color, depth])
    }
}

/// Images that are not later than those before, repeated or out of order, are left out.
fn add(queue: &mut VecDeque<Stamped>, image: Stamped, last: Option<f64>) {
    let before = queue.back().map(|image| image.secs).or(last);
    if before.is_some_and(|before| image.secs <= before) || !image.secs.is_finite() {
        return;
    }
    if queue.len() == WAITING {
        queue.pop_front();
    }
    queue.push_back(image);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(secs: f64) -> Stamped {
        Stamped {
            secs,
            message: Vec::new(),
        }
    }

    fn next(pairs: &mut Pairs) -> Option<[f64; 2]> {
        pairs.next().map(|pair| pair.map(|image| image.secs))
    }

    #[test]
    fn what_was_taken_together_waits_for_nothing() {
        let mut pairs = Pairs::default();
        pairs.add_color(image(1.0));
        assert_eq!(next(&mut pairs), None);
        pairs.add_depth(image(1.004));
        assert_eq!(next(&mut pairs), Some([1.0, 1.004]));
        assert_eq!(next(&mut pairs), None);
    }

    #[test]
    fn what_may_have_a_nearer_partner_waits_for_it() {
        let mut pairs = Pairs::default();
        pairs.add_color(image(1.0));
        pairs.add_depth(image(0.985));
        assert_eq!(next(&mut pairs), None);
        pairs.add_depth(image(1.012));
        pairs.add_color(image(1.033));
        assert_eq!(next(&mut pairs), Some([1.0, 1.012]));
        // 0.985 is older and was forgotten.
        pairs.add_depth(image(1.045));
        pairs.add_depth(image(1.078));
        pairs.add_color(image(1.066));
        assert_eq!(next(&mut pairs), Some([1.033, 1.045]));
    }

    #[test]
    fn one_sensor_that_fails_leaves_no_queue() {
        let mut pairs = Pairs::default();
        for i in 0..1000 {
            pairs.add_color(image(f64::from(i)));
        }
        assert_eq!(pairs.color.len(), WAITING);
        pairs.add_depth(image(999.0));
        assert_eq!(next(&mut pairs), Some([999.0, 999.0]));
        assert!(pairs.color.is_empty() && pairs.depth.is_empty());
    }

    #[test]
    fn what_comes_twice_or_late_is_left_out() {
        let mut pairs = Pairs::default();
        for secs in [1.0, 2.0, 2.0, 1.5, f64::NAN] {
            pairs.add_color(image(secs));
            pairs.add_depth(image(secs));
        }
        assert_eq!(next(&mut pairs), Some([1.0, 1.0]));
        assert_eq!(next(&mut pairs), Some([2.0, 2.0]));
        pairs.add_color(image(2.0));
        pairs.add_depth(image(2.0));
        assert_eq!(next(&mut pairs), None);
    }
}
