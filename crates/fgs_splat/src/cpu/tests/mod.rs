//! The CPU rasteriser against closed forms, the reference and its own symmetries.

mod gradients;
pub mod inspect;
pub mod scenes;
mod symmetries;
mod values;
