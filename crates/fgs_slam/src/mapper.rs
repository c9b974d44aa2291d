//! The mapper: gives the map the gaussians it lacks and optimises it, keyframe by keyframe
//! (paper, Sec. III-A and III-D). A plain struct without threads.

use fgs_geom::{Camera, FrameIndex, Image, KeyframeId, View};
use fgs_splat::{
    GaussianModel, Gaussians, LossError, ModelError, ModelSettings, PruneRule, SparseId, Target,
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
    views: Vec<(KeyframeId, FrameIndex)>,
    next_id: KeyframeId,
    steps: usize,
    /// Sparse points that the mask refused since the last call of `take_removed`.
    refused: Vec<SparseId>,
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
            next_id: KeyframeId(0),
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
        let detail = self.segmenter.segment(&frame.color);
        let new_points = self.admit(&keyframe.new_points, &missing);
        let seeder = Seeder::new(
            frame,
            keyframe.world_from_camera,
            &detail,
            &self.config.seeding,
            seeding_surface(&self.config.tracking, &frame.camera),
        );
        let id = self.next_id;
        self.next_id.0 += 1;
        self.model
            .insert(&seeder.seeds(&missing, &new_points), id)?;
        let target = Target::new(frame.color.clone(), frame.depth_m.clone())?;
        self.model.add_view(id, view, target)?;
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

    /// The points that left the sparse map and were not yet reported.
    ///
    /// # Errors
    /// If the model fails.
    pub fn take_removed(&mut self) -> Result<Vec<SparseId>, MapperError> {
        let mut removed = self.model.take_removed()?;
        removed.append(&mut self.refused);
        Ok(removed)
    }

    /// Bytes that the map takes on a graphics device.
    pub fn device_bytes(&self) -> u64 {
        self.model.device_bytes()
    }

    /// The map; after a failure, as far as it is known.
    pub fn into_gaussians(self) -> Gaussians {
        Box::new(self.model).into_gaussians()
    }

    fn admit(&mut self, new_points: &[NewPoint], missing: &Image<bool>) -> Vec<NewPoint> {
        match self.config.keyframes.new_points {
            NewPoints::Distance => new_points.to_vec(),
            NewPoints::Mask => {
                let (admitted, refused): (Vec<NewPoint>, Vec<NewPoint>) =
                    new_points.iter().partition(|p| missing.at(p.u, p.v));
                self.refused.extend(refused.iter().map(|p| p.id));
                admitted
            }
        }
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
