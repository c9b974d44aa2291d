//! What a keyframe needs before it can join the map, apart from the map itself: its detail mask, its
//! seeds, and the images that it will be compared with (paper, Sec. III-A). A plain struct without
//! threads; since it does not touch the model, it can work while the mapper optimises.

use fgs_geom::{Camera, Image};
use fgs_gicp::DepthGrid;
use fgs_splat::{LossError, Seeds, Target};

use crate::config::{SeedingConfig, SlamConfig};
use crate::frequency::{FrequencySegmenter, FrequencySettings};
use crate::keyframes::Keyframe;
use crate::seeding::Seeder;
use crate::surface::seeding_surface;

/// The published code equalises contrast, of which the paper does not speak. On three recordings it
/// made up to 0.12 dB of difference either way, and better SSIM.
const SEGMENTATION: FrequencySettings = FrequencySettings { clahe: true };

/// Prepares keyframes of one camera.
pub struct KeyframePreparer {
    segmenter: FrequencySegmenter,
    seeding: SeedingConfig,
    surface: DepthGrid,
}

/// A keyframe that is ready to join the map.
pub struct PreparedKeyframe {
    /// The keyframe.
    pub keyframe: Keyframe,
    /// What the map lacks of it.
    pub seeds: Seeds,
    /// What it looks like.
    pub target: Target,
    /// Where its image has detail.
    pub detail: Image<bool>,
    /// Where the map lacked gaussians.
    pub missing: Image<bool>,
}

impl KeyframePreparer {
    /// For frames of one camera.
    pub fn new(camera: &Camera, config: &SlamConfig) -> Self {
        Self {
            segmenter: FrequencySegmenter::new(camera.width, camera.height, SEGMENTATION),
            seeding: config.seeding.clone(),
            surface: seeding_surface(config, camera),
        }
    }

    /// Prepares a keyframe, given the region where the map lacks gaussians.
    ///
    /// # Errors
    /// If the keyframe's images do not belong together.
    pub fn prepare(
        &mut self,
        keyframe: Keyframe,
        missing: Image<bool>,
    ) -> Result<PreparedKeyframe, LossError> {
        let frame = &keyframe.frame;
        let detail = self.segmenter.segment_frame(frame);
        let seeder = Seeder::new(
            frame,
            keyframe.world_from_camera,
            &detail,
            &self.seeding,
            self.surface,
        );
        let seeds = seeder.seeds(&missing, &keyframe.new_points);
        let target = Target::from_frame(frame)?;
        Ok(PreparedKeyframe {
            keyframe,
            seeds,
            target,
            detail,
            missing,
        })
    }
}
