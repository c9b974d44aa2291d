//! Estimating the pose of a source relative to a target.

mod align;
mod alignment;
mod factor;
mod linear_system;
mod pair_batch;
mod settings;

pub use align::align;
pub use alignment::{AlignError, Alignment, Conditioning};
pub use factor::Factor;
pub use linear_system::LinearSystem;
pub use settings::{Kernel, Settings};
