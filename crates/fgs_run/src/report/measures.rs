//! What is plotted over the frames of a run.

use super::run_data::RunData;

/// A number that a frame has, or not.
pub struct Measure {
    pub name: &'static str,
    pub unit: &'static str,
    pub meaning: &'static str,
    /// Whether its axis begins at zero.
    pub from_zero: bool,
    /// That of the frame at a place of the run.
    pub value: fn(&RunData, usize) -> Option<f64>,
}

/// Every plot, from top to bottom.
pub const MEASURES: [Measure; 5] = [
    Measure {
        name: "Position error",
        unit: "cm",
        meaning: "distance to the reference trajectory after rigid alignment",
        from_zero: true,
        value: |run, place| Some(100.0 * run.position_error_m(place)?),
    },
    Measure {
        name: "PSNR",
        unit: "dB",
        meaning: "the map rendered at the frame's pose against its image, where depth is measured",
        from_zero: false,
        value: |run, place| run.rows[place].scores.get("psnr_valid_depth_db"),
    },
    Measure {
        name: "Likeness",
        unit: "",
        meaning: "how much the frame looks like a keyframe where both see the same, up to 1",
        from_zero: true,
        value: |run, place| run.rows[place].likeness,
    },
    Measure {
        name: "Moving share",
        unit: "",
        meaning: "share of the image that was left out because it moves",
        from_zero: true,
        value: |run, place| run.rows[place].moving_share,
    },
    Measure {
        name: "Tracking",
        unit: "ms",
        meaning: "wall-clock time of tracking the frame",
        from_zero: true,
        value: |run, place| run.rows[place].tracking_ms,
    },
];
