//! The optimisation steps that are due.

use serde::{Deserialize, Serialize};

/// Spreads a fractional number of steps per frame evenly: after n frames, floor(n * rate) steps.
#[derive(Clone, Default, Serialize, Deserialize)]
pub struct Budget {
    frames: usize,
    steps: usize,
}

impl Budget {
    /// The steps due after one more frame.
    pub fn next_frame(&mut self, per_frame: f64) -> usize {
        self.frames += 1;
        let total = (self.frames as f64 * per_frame).floor() as usize;
        let due = total.saturating_sub(self.steps);
        self.steps = total;
        due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fractions_add_up() {
        let mut budget = Budget::default();
        let steps: Vec<usize> = (0..10).map(|_| budget.next_frame(2.8)).collect();
        assert_eq!(steps, [2, 3, 3, 3, 3, 2, 3, 3, 3, 3]);
    }
}
