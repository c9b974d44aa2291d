//! The optimisation steps that are due.

use serde::{Deserialize, Serialize};

/// Spreads a fractional number of steps per frame evenly: after n frames, floor(n * rate) steps.
#[derive(Clone, Default, Serialize, Deserialize)]
pub struct Budget {
    frames: usize,
    steps: usize,
    /// Due, but not taken when the session was stopped.
    owed: usize,
}

impl Budget {
    /// The steps due after one more frame.
    pub fn next_frame(&mut self, per_frame: f64) -> usize {
        self.frames += 1;
        let total = (self.frames as f64 * per_frame).floor() as usize;
        let due = total.saturating_sub(self.steps);
        self.steps = total;
        due + self.take_owed()
    }

    /// Steps that were due are not taken now.
    pub fn owe(&mut self, steps: usize) {
        self.owed += steps;
    }

    /// The steps of earlier frames that are still due.
    pub fn take_owed(&mut self) -> usize {
        std::mem::take(&mut self.owed)
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
