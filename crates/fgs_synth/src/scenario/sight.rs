//! Sensors that see nothing, or something else than before.

use std::sync::Arc;

use super::stage::Stage;
use super::{Lens, SEED, Scenario, stretch};

/// Neither colour nor depth for two seconds, in which the camera goes back a bit.
pub(super) fn black(scenario: &mut Scenario) {
    without_sight(scenario, Lens::Off);
}

/// As black, but with noise in the dark and depth of what covers the lens.
pub(super) fn covered(scenario: &mut Scenario) {
    without_sight(scenario, Lens::Covered);
}

fn without_sight(scenario: &mut Scenario, lens: Lens) {
    let room = Arc::new(Stage::furnished(SEED));
    scenario.film(&room, stretch(0.0, 50.0, 50));
    scenario.disturb(&room, stretch(50.0, 20.0, 60));
    for shot in &mut scenario.shots[scenario.disturbed.clone()] {
        shot.lens = lens;
    }
    scenario.film(&room, stretch(20.0, 50.0, 30));
}

/// The gain of colour jumps between half and almost double.
pub(super) fn exposure(scenario: &mut Scenario) {
    let room = Arc::new(Stage::furnished(SEED));
    scenario.film(&room, stretch(0.0, 20.0, 20));
    for (step, gain) in [0.5, 1.8, 0.7, 1.8, 0.5].into_iter().enumerate() {
        let from = 20.0 + 8.0 * step as f64;
        scenario.film(&room, stretch(from, from + 8.0, 8));
        for shot in scenario.shots.iter_mut().rev().take(8) {
            shot.gain = gain;
        }
    }
    scenario.disturbed = 20..scenario.len();
    scenario.film(&room, stretch(60.0, 80.0, 20));
}
