//! Refinement: after the recording has ended, the map is optimised further with all keyframes alike,
//! as a reconstruction from known poses would be. What the camera sees now no longer matters, so
//! covisibility does not either.

use std::time::Duration;

use fgs_geom::KeyframeId;
use fgs_splat::Gaussians;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// A map that was optimised further after the recording had ended.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct RefinedMap {
    /// The map.
    pub gaussians: Gaussians,
    /// Optimisation steps taken after the end of the recording; fewer than asked for if it was
    /// stopped or the mapper failed.
    pub steps: usize,
    /// Wall-clock time that they took.
    pub duration: Duration,
}

/// Draws views in rounds: each round is a random order of all of them, so that all are drawn equally
/// often up to one. The same seed and views give the same draws.
pub struct Rounds {
    rng: Pcg64Mcg,
    views: Vec<KeyframeId>,
    /// Those that this round has not drawn yet.
    left: Vec<KeyframeId>,
}

impl Rounds {
    pub fn new(seed: u64, views: Vec<KeyframeId>) -> Self {
        Self {
            rng: Pcg64Mcg::seed_from_u64(seed),
            views,
            left: Vec::new(),
        }
    }

    /// The next view; `None` if there are none.
    pub fn draw(&mut self) -> Option<KeyframeId> {
        if self.left.is_empty() {
            self.left.clone_from(&self.views);
        }
        let count = self.left.len();
        (count > 0).then(|| self.left.swap_remove(self.rng.random_range(0..count)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn draws(seed: u64, count: usize) -> Vec<u32> {
        let mut rounds = Rounds::new(seed, (0..5).map(KeyframeId).collect());
        (0..count).map(|_| rounds.draw().unwrap().0).collect()
    }

    #[test]
    fn every_view_is_drawn_once_a_round() {
        for round in draws(7, 5000).chunks(5) {
            let mut round = round.to_vec();
            round.sort_unstable();
            assert_eq!(round, [0, 1, 2, 3, 4]);
        }
    }

    /// Of 1000 rounds each view comes first in about 200: 13 is the standard deviation.
    #[test]
    fn every_view_comes_at_every_place_equally_often() {
        let draws = draws(7, 5000);
        for place in 0..5 {
            for view in 0..5 {
                let at_place = draws.iter().skip(place).step_by(5);
                let count = at_place.filter(|drawn| **drawn == view).count();
                assert!((150..250).contains(&count), "{view} at {place}: {count}");
            }
        }
    }

    #[test]
    fn the_seed_decides() {
        assert_eq!(draws(7, 50), draws(7, 50));
        assert_ne!(draws(7, 50), draws(8, 50));
        assert_eq!(Rounds::new(7, Vec::new()).draw(), None);
    }
}
