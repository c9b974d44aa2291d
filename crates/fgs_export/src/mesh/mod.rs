//! The map's surface as a triangle mesh: depth rendered at the keyframes' poses, fused in a volume of
//! truncated signed distances (Curless and Levoy 1996), whose zero surface is extracted.

mod depth;
mod surface;
mod vertex_colors;
mod volume;

use std::ops::ControlFlow;

use fgs_geom::View;
use fgs_splat::{Gaussians, Rasterizer};

use crate::ExportError;
use crate::error::go_on;
use depth::SurfaceImage;
use vertex_colors::VertexColors;
use volume::Volume;

/// A triangle mesh. Its front, counter-clockwise, is the side that was seen.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertices, world of the run, metres, [N, 3].
    pub positions: Vec<[f32; 3]>,
    /// Unit vectors away from the surface's front, [N, 3].
    pub normals: Vec<[f32; 3]>,
    /// sRGB, 0 to 1, [N, 3].
    pub colors: Vec<[f32; 3]>,
    /// Indices of three vertices each.
    pub triangles: Vec<[u32; 3]>,
}

/// The surface of a map as seen from `views`, with voxels of `voxel_m`. Gaussians at an inferred depth
/// are left out. `on_view` is called three times for each view and may stop the work. Memory grows with the area of the surface
/// (4 kB for each block of 8x8x8 voxels near it), whatever the number of views.
///
/// # Errors
/// [`ExportError::NoKeyframes`] without views, [`ExportError::TooManyVoxels`] beyond 2 GB,
/// [`ExportError::Stopped`].
pub fn surface_mesh(
    gaussians: &Gaussians,
    views: &[View],
    voxel_m: f64,
    on_view: &mut dyn FnMut() -> ControlFlow<()>,
) -> Result<Mesh, ExportError> {
    if views.is_empty() {
        return Err(ExportError::NoKeyframes);
    }
    let mut measured = gaussians.clone();
    let is_measured: Vec<bool> = gaussians
        .inferred
        .iter()
        .map(|inferred| !inferred)
        .collect();
    measured.retain(&is_measured);

    let mut volume = Volume::new(voxel_m);
    let truncation_m = volume.truncation_m();
    let mut rasterizer = Rasterizer::default();
    // Rendered anew each time: all images together would take memory with the number of views.
    let mut image = |view| {
        let image = SurfaceImage::new(&mut rasterizer, &measured, view, truncation_m);
        go_on(on_view()).map(|()| image)
    };
    for view in views {
        volume.allocate(&image(view)?.depth_m, view)?;
    }
    for view in views {
        volume.integrate(&image(view)?.depth_m, view);
    }
    let mut mesh = volume.surface();
    drop(volume);
    let mut colors = VertexColors::new(mesh.positions.len());
    for view in views {
        colors.add(&mesh.positions, &image(view)?, view, truncation_m);
    }
    mesh.colors = colors.mean();
    Ok(mesh)
}
