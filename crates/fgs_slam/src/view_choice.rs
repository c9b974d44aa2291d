//! Which keyframe to optimise next (paper, Sec. III-C): covisible ones for the part of the map in
//! front of the camera, random others against forgetting.

use std::collections::VecDeque;

use fgs_geom::KeyframeId;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

/// Draws keyframes; the same seed and calls give the same draws.
#[derive(Clone, Serialize, Deserialize)]
pub struct ViewChoice {
    rng: Pcg64Mcg,
    covisible: Vec<KeyframeId>,
    others: Vec<KeyframeId>,
    /// Views to be drawn before all others.
    first: VecDeque<KeyframeId>,
}

impl ViewChoice {
    /// Without any view to draw.
    pub fn new(seed: u64) -> Self {
        Self {
            rng: Pcg64Mcg::seed_from_u64(seed),
            covisible: Vec::new(),
            others: Vec::new(),
            first: VecDeque::new(),
        }
    }

    /// A new keyframe came. `covisibility` is the share of its visible gaussians that each of the
    /// other views shows too; those above `min_share`, and the new one, are covisible. The new one
    /// is drawn `newest_first` times before any other.
    pub fn set_current(
        &mut self,
        current: KeyframeId,
        covisibility: &[(KeyframeId, f32)],
        min_share: f32,
        newest_first: usize,
    ) {
        let (covisible, others): (Vec<_>, Vec<_>) = covisibility
            .iter()
            .partition(|(_, share)| *share > min_share);
        self.covisible = covisible.into_iter().map(|(id, _)| id).collect();
        self.covisible.push(current);
        self.others = others.into_iter().map(|(id, _)| id).collect();
        for _ in 0..newest_first {
            self.first.push_front(current);
        }
    }

    /// These views are drawn before all others but the newest.
    pub fn draw_first(&mut self, views: impl IntoIterator<Item = KeyframeId>) {
        self.first.extend(views);
    }

    /// A view is gone.
    pub fn forget(&mut self, id: KeyframeId) {
        self.covisible.retain(|view| *view != id);
        self.others.retain(|view| *view != id);
        self.first.retain(|view| *view != id);
    }

    /// The next view to optimise, a covisible one with some probability; `None` before the first
    /// keyframe.
    pub fn draw(&mut self, covisible_probability: f64) -> Option<KeyframeId> {
        if let Some(first) = self.first.pop_front() {
            return Some(first);
        }
        let covisible = self.rng.random::<f64>() < covisible_probability;
        let group = match (covisible, self.covisible.is_empty(), self.others.is_empty()) {
            (_, true, true) => return None,
            (_, _, true) | (true, false, _) => &self.covisible,
            _ => &self.others,
        };
        Some(group[self.rng.random_range(0..group.len())])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn views() -> ViewChoice {
        let mut choice = ViewChoice::new(7);
        let covisibility = [
            (KeyframeId(0), 0.1),
            (KeyframeId(1), 0.7),
            (KeyframeId(2), 0.71),
        ];
        choice.set_current(KeyframeId(3), &covisibility, 0.7, 2);
        choice
    }

    #[test]
    fn newest_first_then_seventy_to_thirty() {
        let mut choice = views();
        assert_eq!(choice.draw(0.7), Some(KeyframeId(3)));
        assert_eq!(choice.draw(0.7), Some(KeyframeId(3)));
        let mut counts = [0; 4];
        for _ in 0..10_000 {
            counts[choice.draw(0.7).unwrap().0 as usize] += 1;
        }
        for (count, share) in counts.iter().zip([0.15, 0.15, 0.35, 0.35]) {
            assert!(
                (f64::from(*count) / 1e4 - share).abs() <= 0.015,
                "{counts:?}"
            );
        }
    }

    #[test]
    fn what_is_to_be_drawn_first_waits_only_for_the_newest() {
        let mut choice = views();
        choice.draw_first([KeyframeId(1), KeyframeId(0)]);
        choice.set_current(KeyframeId(4), &[], 0.7, 1);
        choice.forget(KeyframeId(3));
        let drawn: Vec<u32> = (0..3).map(|_| choice.draw(0.7).unwrap().0).collect();
        assert_eq!(drawn, [4, 1, 0]);
    }

    #[test]
    fn repeats_itself() {
        let draws = |mut choice: ViewChoice| (0..50).map(|_| choice.draw(0.7)).collect::<Vec<_>>();
        assert_eq!(draws(views()), draws(views()));
    }

    #[test]
    fn draws_what_there_is() {
        let mut choice = ViewChoice::new(7);
        assert_eq!(choice.draw(0.7), None);
        choice.set_current(KeyframeId(0), &[], 0.7, 0);
        assert!((0..20).all(|_| choice.draw(0.7) == Some(KeyframeId(0))));
        choice.set_current(KeyframeId(1), &[(KeyframeId(0), 0.0)], 0.7, 5);
        choice.forget(KeyframeId(1));
        assert!((0..20).all(|_| choice.draw(0.7) == Some(KeyframeId(0))));
    }
}
