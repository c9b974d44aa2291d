//! Procedural RGB-D rooms.
