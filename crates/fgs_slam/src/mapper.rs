//! The mapper: gives the map the gaussians it lacks and optimises it, keyframe by keyframe
//! (paper, Sec. III-A and III-D). A plain struct without threads.

use fgs_geom::{Camera, FrameIndex, Image, View};
use fgs_splat::{
    GaussianModel, Gaussians, LossError, ModelError, ModelSettings, PruneRule, SparseChanges,
    Target, ViewId,
};

use crate::config::{MappingConfig, NewPoints, SlamConfig};
use crate::frequency::{FrequencySegmenter, FrequencySettings};
use crate::keyframes::{Keyframe, NewPoint};
use crate::missing::missing_region;
use crate::seeding::Seeder;
use crate::surface::seeding_surface;
use crate::view_choice::ViewChoice;

/// Why the mapper cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum MapperError {
    /// The model refused a call.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A keyframe's images do not belong together.
    #[error(transparent)]
    Keyframe(#[from] LossError),
}

/// Owns the map.
pub struct Mapper<M> {
    model: M,
    config: SlamConfig,
    segmenter: FrequencySegmenter,
    choice: ViewChoice,
    /// The keyframes that can be optimised, in the order they came.
    views: Vec<(ViewId, FrameIndex)>,
    steps: usize,
    /// Sparse points that were refused since the last call of `take_sparse_changes`.
    refused: Vec<fgs_splat::SparseId>,
}

/// How a configuration asks the model to optimise.
pub fn model_settings(config: &MappingConfig) -> ModelSettings {
    ModelSettings {
        loss: config.loss.clone(),
        learning_rates: config.learning_rates.clone(),
    }
}

impl<M: GaussianModel> Mapper<M> {
    /// For frames of one camera, with an empty map.
    pub fn new(model: M, camera: &Camera, config: &SlamConfig) -> Self {
        Self {
            model,
            segmenter: FrequencySegmenter::new(
                camera.width,
                camera.height,
                FrequencySettings {
                    clahe: config.seeding.clahe,
                },
            ),
            choice: ViewChoice::new(config.seed, config.mapping.covisible_probability),
            views: Vec::new(),
            steps: 0,
            refused: Vec::new(),
            config: config.clone(),
        }
    }

    /// Adds what the map lacks of a keyframe and registers it for optimisation.
    ///
    /// # Errors
    /// If the model fails.
    pub fn insert(&mut self, keyframe: &Keyframe) -> Result<(), MapperError> {
        let frame = &keyframe.frame;
        let view = View {
            camera: frame.camera,
            world_from_camera: keyframe.world_from_camera,
        };
        let rendered = self.model.render(&view)?;
        let missing = missing_region(&rendered, frame, &self.config.seeding);
        let detail = self.segmenter.segment_frame(frame);
        let new_points = self.admit(keyframe, &missing);
        let seeder = Seeder::new(
            frame,
            keyframe.world_from_camera,
            &detail,
            &self.config.seeding,
            seeding_surface(&self.config.tracking, &frame.camera),
        );
        self.model.insert(&seeder.seeds(&missing, &new_points))?;
        let target = Target::from_frame(frame)?;
        let id = self.model.add_view(view, target)?;
        let covisibility = self.model.covisibility(id)?;
        let mapping = &self.config.mapping;
        self.choice.set_current(
            id,
            &covisibility,
            mapping.min_covisible_share,
            mapping.newest_first,
        );
        self.views.push((id, frame.index));
        if self.views.len() > mapping.max_keyframes {
            self.drop_most_crowded_view()?;
        }
        Ok(())
    }

    /// One optimisation step; nothing before the first keyframe.
    ///
    /// # Errors
    /// If the model fails.
    pub fn step(&mut self) -> Result<(), MapperError> {
        let Some(view) = self.choice.draw() else {
            return Ok(());
        };
        self.model.step(view)?;
        // Nobody reads them yet; left in the model they would grow with the run.
        self.model.take_stats();
        self.steps += 1;
        let mapping = &self.config.mapping;
        if self.steps.is_multiple_of(mapping.prune_every) {
            self.model.prune(&PruneRule {
                min_opacity: mapping.prune_opacity,
                max_scale_m: mapping.prune_scale_m,
                max_aspect: mapping.prune_aspect,
            })?;
        }
        Ok(())
    }

    /// How many steps were taken.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// How many gaussians the map has.
    pub fn num_gaussians(&self) -> usize {
        self.model.len()
    }

    /// What happened to the sparse map since the last call.
    ///
    /// # Errors
    /// If the model fails.
    pub fn take_sparse_changes(&mut self) -> Result<SparseChanges, MapperError> {
        let mut changes = self.model.take_sparse_changes()?;
        changes.removed.append(&mut self.refused);
        Ok(changes)
    }

    /// Bytes that the map takes on a graphics device.
    pub fn device_bytes(&self) -> u64 {
        self.model.device_bytes()
    }

    /// The map; after a failure, as far as it is known.
    pub fn into_gaussians(self) -> Gaussians {
        self.model.into_gaussians()
    }

    /// The keyframe's sparse points that get a gaussian: those with a colour to give it and, if the
    /// mask decides, in the missing region. The tracker hears of the others.
    fn admit(&mut self, keyframe: &Keyframe, missing: &Image<bool>) -> Vec<NewPoint> {
        let by_mask = self.config.keyframes.new_points == NewPoints::Mask;
        let (admitted, refused): (Vec<NewPoint>, Vec<NewPoint>) = (keyframe.new_points.iter())
            .partition(|p| {
                keyframe.frame.has_color(p.u, p.v) && (!by_mask || missing.at(p.u, p.v))
            });
        self.refused.extend(refused.iter().map(|p| p.id));
        admitted
    }

    /// Forgets the keyframe that came soonest after its predecessor, so that those kept stay spread
    /// over the whole recording. The newest and the first stay.
    fn drop_most_crowded_view(&mut self) -> Result<(), MapperError> {
        let gap = |i: &usize| self.views[*i].1.0 - self.views[*i - 1].1.0;
        if let Some(crowded) = (1..self.views.len() - 1).min_by_key(gap) {
            let (id, _) = self.views.remove(crowded);
            self.choice.forget(id);
            self.model.drop_view(id)?;
        }
        Ok(())
    }
}
