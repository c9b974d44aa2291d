//! The CPU rasteriser against closed forms, the reference and its own symmetries.

mod gradients;
mod scenes;
mod symmetries;
mod values;
