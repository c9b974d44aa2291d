//! Generalised ICP.
