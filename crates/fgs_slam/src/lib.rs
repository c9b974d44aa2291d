//! FGS-SLAM.

pub mod frequency;
