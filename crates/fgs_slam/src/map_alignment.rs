//! A keyframe, before it joins the map, and every frame between keyframes is moved to where the map
//! looks most like it: the map averages over many keyframes, each of which has an error of its own.
//!
//! Differs from the paper, whose frames stay where tracking put them.

use fgs_direct::{
    IntensityImage, IntensityPyramid, PosePrior, PosedReference, Reference, align_with_keyframes,
};
use fgs_geom::{FrameIndex, Image, Se3, View};
use fgs_splat::{GaussianModel, ModelError};
use serde::{Deserialize, Serialize};

/// A pixel of a render shows the map if it is this opaque.
const MIN_ALPHA: f32 = 0.95;

/// A frame that can be aligned with the map.
pub struct FrameToAlign {
    /// Which frame.
    pub index: FrameIndex,
    /// Its brightness.
    pub pyramid: IntensityPyramid,
    /// What tracking says of its pose.
    pub prior: PosePrior,
}

/// What the map looks like from a pose. Frames taken nearby can be aligned with it.
#[derive(Clone, Serialize, Deserialize)]
pub struct MapReference {
    reference: Reference,
    world_from_camera: Se3,
}

impl MapReference {
    /// Renders the map where an image was probably taken, as fine as the image and as its pyramid has
    /// levels.
    ///
    /// # Errors
    /// If the model fails.
    pub fn render(
        model: &mut dyn GaussianModel,
        pyramid: &IntensityPyramid,
        world_from_camera: &Se3,
    ) -> Result<Self, ModelError> {
        let camera = pyramid.levels[0].camera;
        let rendered = model.render(&View {
            camera,
            world_from_camera: *world_from_camera,
        })?;
        let is_seen = rendered.alpha.map(|alpha| *alpha >= MIN_ALPHA);
        let depth_m = Image::from_fn(camera.width, camera.height, |u, v| {
            rendered.surface_depth_m(u, v)
        });
        let finest = IntensityImage::of_render(camera, &rendered.color, &is_seen);
        let pyramid = IntensityPyramid::new(finest, pyramid.levels.len());
        Ok(Self {
            reference: Reference::new(&pyramid, &depth_m, &camera),
            world_from_camera: *world_from_camera,
        })
    }

    /// The pose at which an image fits the map best, given how sure tracking was of it; `None` if the
    /// map shows too little of it.
    pub fn align(&self, pyramid: &IntensityPyramid, prior: &PosePrior) -> Option<Se3> {
        let posed = PosedReference {
            reference: &self.reference,
            world_from_reference: self.world_from_camera,
        };
        let aligned = align_with_keyframes(pyramid, &[posed], prior)?;
        (!aligned.contradicts_prior).then_some(aligned.world_from_camera)
    }
}
