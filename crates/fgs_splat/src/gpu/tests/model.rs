//! The whole model against the CPU's.
