//! Reading RGB-D recordings.
