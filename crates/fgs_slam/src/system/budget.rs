//! The optimisation steps that are due.

/// Spreads a fractional number of steps per frame evenly: after n frames, floor(n * rate) steps.
pub struct Budget {
    per_frame: f64,
    frames: usize,
    steps: usize,
}

impl Budget {
    pub fn new(per_frame: f64) -> Self {
        Self {
            per_frame,
            frames: 0,
            steps: 0,
        }
    }

    /// The steps due after one more frame.
    pub fn next_frame(&mut self) -> usize {
        self.frames += 1;
        let total = (self.frames as f64 * self.per_frame).floor() as usize;
        let due = total - self.steps;
        self.steps = total;
        due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fractions_add_up() {
        let mut budget = Budget::new(2.8);
        let steps: Vec<usize> = (0..10).map(|_| budget.next_frame()).collect();
        assert_eq!(steps, [2, 3, 3, 3, 3, 2, 3, 3, 3, 3]);
    }
}
