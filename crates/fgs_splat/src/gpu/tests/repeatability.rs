//! The same calls give the same bits.
