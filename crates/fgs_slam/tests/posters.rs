//! Cameras before walls with posters: where geometry slides, and with shutters that roll.

#![allow(clippy::unwrap_used)]

#[path = "common/posters.rs"]
mod scene;

use scene::Posters;

#[test]
fn posters_hold_the_camera_where_geometry_slides() {
    let wall = Posters {
        corner: false,
        shift_m: 0.3,
        turn_rad: 0.08,
        period_frames: 200.0,
        readout_secs: 0.0,
    };
    let (with, without) = (wall.error_m(300, true, 0.0), wall.error_m(300, false, 0.0));
    assert!(with <= 0.003, "{with} m");
    assert!(without >= 0.1, "{without} m");
}

#[test]
fn a_rolling_shutter_that_is_known_does_no_harm() {
    let corner = Posters {
        corner: true,
        shift_m: 0.05,
        turn_rad: 0.35,
        period_frames: 60.0,
        readout_secs: 0.03,
    };
    let (known, ignored) = (
        corner.error_m(60, true, 0.03),
        corner.error_m(60, true, 0.0),
    );
    assert!(known <= 0.006, "{known} m");
    assert!(ignored >= 0.02, "{ignored} m");
}
