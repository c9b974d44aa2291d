//! Before a keyframe joins the map it is moved to where the map looks most like it: the map averages
//! over many keyframes, each of which has an error of its own.
//!
//! Differs from the paper, whose keyframes stay where tracking put them.

use fgs_direct::{
    IntensityImage, IntensityPyramid, PosePrior, PosedReference, Reference, align_with_keyframes,
};
use fgs_geom::{Image, Se3, View};
use fgs_splat::{GaussianModel, ModelError};

use crate::color_aligner::ColorAligner;
use crate::keyframes::Keyframe;

/// A pixel of a render shows the map if it is this opaque.
const MIN_ALPHA: f32 = 0.95;

/// The pose at which a keyframe's image fits the map best, given how sure tracking was of it; `None`
/// if the map shows too little of it.
///
/// # Errors
/// If the model fails.
pub fn align_with_map(
    model: &mut dyn GaussianModel,
    keyframe: &Keyframe,
) -> Result<Option<Se3>, ModelError> {
    let Some(information) = keyframe.information else {
        return Ok(None);
    };
    let pyramid = ColorAligner::pyramid(&keyframe.frame);
    let world_from_camera = keyframe.world_from_camera;
    // Only as fine as it is compared.
    let camera = pyramid.levels[0].camera;
    let rendered = model.render(&View {
        camera,
        world_from_camera,
    })?;
    let is_seen = rendered.alpha.map(|alpha| *alpha >= MIN_ALPHA);
    let depth_m = Image::from_fn(camera.width, camera.height, |u, v| {
        rendered.surface_depth_m(u, v)
    });
    let finest = IntensityImage::of_render(camera, &rendered.color, &is_seen);
    let reference = Reference::new(
        &IntensityPyramid::new(finest, pyramid.levels.len()),
        &depth_m,
        &camera,
    );
    let posed = PosedReference {
        reference: &reference,
        world_from_reference: world_from_camera,
    };
    let prior = PosePrior {
        world_from_camera,
        information,
    };
    let aligned = align_with_keyframes(&pyramid, &[posed], &prior);
    Ok(aligned.map(|aligned| aligned.world_from_camera))
}
