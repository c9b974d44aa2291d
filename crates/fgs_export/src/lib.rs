//! Takes a finished run away in the formats that other programs read.
//!
//! The world of a run has its origin and axes in the first camera: x right, y down, z forward, metres;
//! [`Level`] turns it level.
//! Formats that define axes of their own get theirs; each function says which.
//!
//! | what | formats |
//! |---|---|
//! | gaussians | [`write_splat_ply`], [`write_splat`], [`write_spz`], [`write_compressed_ply`], [`write_splat_glb`] |
//! | points | [`write_points`] of [`surface_points`] |
//! | mesh | [`write_mesh_ply`], [`write_mesh_obj`], [`write_mesh_glb`] of [`surface_mesh`] |
//! | trajectory | [`write_kitti`]; TUM's format is [`fgs_data::Trajectory::write`] |
//! | which way is up, and to level axes | [`up_direction`], [`Level`] |
//! | photographs with poses | [`TrainingSet::write_colmap`], [`TrainingSet::write_nerfstudio`] |

mod colmap;
mod compressed_ply;
mod error;
mod glb;
mod keyframe_images;
mod kitti;
mod level;
mod mesh;
mod mesh_files;
mod nerfstudio;
mod ply;
mod points;
mod quantities;
mod splat;
mod splat_glb;
mod splat_ply;
mod spz;
mod training_set;
mod up;

pub use compressed_ply::write_compressed_ply;
pub use error::ExportError;
pub use keyframe_images::Keyframe;
pub use kitti::write_kitti;
pub use level::Level;
pub use mesh::{Mesh, surface_mesh};
pub use mesh_files::{write_mesh_glb, write_mesh_obj, write_mesh_ply};
pub use points::{Point, surface_points, write_points};
pub use quantities::unit_quat;
pub use splat::{splat_record, write_splat};
pub use splat_glb::write_splat_glb;
pub use splat_ply::write_splat_ply;
pub use spz::write_spz;
pub use training_set::TrainingSet;
pub use up::up_direction;
