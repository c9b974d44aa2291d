//! Trajectory and image metrics.
