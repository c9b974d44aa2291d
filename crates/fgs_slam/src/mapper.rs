//! The mapper: gives the map the gaussians it lacks and optimises it, keyframe by keyframe
//! (paper, Sec. III-A and III-D). A plain struct without threads.

use fgs_direct::PosePrior;
use fgs_geom::{FrameIndex, Image, KeyframeId, Se3};
use fgs_splat::{
    GaussianModel, Gaussians, LossError, ModelError, ModelSettings, PruneRule, SavedModel, SparseId,
};
use serde::{Deserialize, Serialize};

use crate::color_aligner::ColorAligner;
use crate::config::{MappingConfig, SlamConfig};
use crate::image_memory;
use crate::keyframes::Keyframe;
use crate::map_alignment::{FrameToAlign, MapReference};
use crate::merge::Renumbering;
use crate::missing::missing_region;
use crate::prepare::PreparedKeyframe;
use crate::refinement::Rounds;
use crate::seam::{Seam, views_of};
use crate::view_choice::ViewChoice;

/// A keyframe that shows more than this share of the newest keyframe's gaussians is covisible with
/// it (paper, Sec. III-C).
const MIN_COVISIBLE_SHARE: f32 = 0.7;

/// How many of a new keyframe's first steps go to itself: its gaussians have seen no step yet.
const NEWEST_FIRST: usize = 1;

/// Which gaussians are of no use: the published limits for real sensors. 10 cm, published for
/// Replica, takes away what stands in for window panes.
const PRUNE_RULE: PruneRule = PruneRule {
    min_opacity: 0.005,
    max_scale_m: 1.0,
    max_aspect: 10.0,
};

/// So many frames between keyframes are aligned with one render of the map. Rendering costs thirty times as
/// much as alignment.
const FRAMES_PER_RENDER: usize = 4;

/// Why the mapper cannot go on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MapperError {
    /// The model refused a call.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A keyframe's images do not belong together.
    #[error(transparent)]
    Keyframe(#[from] LossError),
    /// The mapper panicked: a bug.
    #[error("the mapper stopped on an internal error: {0}")]
    Panicked(String),
}

/// Owns the map.
pub struct Mapper {
    model: Box<dyn GaussianModel>,
    config: SlamConfig,
    state: MapperState,
}

/// What a mapper knows beside the map.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct MapperState {
    choice: ViewChoice,
    /// The keyframes that can be optimised, in the order they came.
    views: Vec<(KeyframeId, FrameIndex)>,
    /// What frames are aligned with, and how many were.
    reference: Option<(MapReference, usize)>,
    steps: usize,
}

impl MapperState {
    /// Of an empty map.
    pub fn new(seed: u64) -> Self {
        Self {
            choice: ViewChoice::new(seed),
            views: Vec::new(),
            reference: None,
            steps: 0,
        }
    }

    /// What was counted begins anew.
    pub fn forget_counts(&mut self) {
        self.steps = 0;
    }

    /// Takes in what is known of another map.
    pub fn append(&mut self, other: Self, renumbering: Renumbering) {
        let views = other.views.into_iter();
        self.views
            .extend(views.map(|(id, index)| (renumbering.keyframe(id), index)));
        self.reference = None;
    }
}

/// How a configuration asks the model to optimise.
pub fn model_settings(config: &MappingConfig) -> ModelSettings {
    ModelSettings {
        loss: config.loss.clone(),
        learning_rates: config.learning_rates.clone(),
    }
}

impl Mapper {
    /// With an empty model.
    pub fn new(model: Box<dyn GaussianModel>, config: &SlamConfig) -> Self {
        Self::restored(model, config, MapperState::new(config.seed))
    }

    /// With a model that belongs to what the mapper knows.
    pub(crate) fn restored(
        model: Box<dyn GaussianModel>,
        config: &SlamConfig,
        state: MapperState,
    ) -> Self {
        Self {
            model,
            config: config.clone(),
            state,
        }
    }

    /// The map, and what else there is to know.
    ///
    /// # Errors
    /// If the model fails.
    pub(crate) fn save(&mut self) -> Result<(SavedModel, MapperState), MapperError> {
        Ok((self.model.save()?, self.state.clone()))
    }

    /// Where the map lacks gaussians for a keyframe (M_m), once those yield that it contradicts.
    ///
    /// # Errors
    /// If the model fails.
    pub fn missing_region(&mut self, keyframe: &Keyframe) -> Result<Image<bool>, MapperError> {
        let (view, frame) = (keyframe.view(), &keyframe.frame);
        self.model.fade_contradicted(&view, &frame.depth_m)?;
        let missing = missing_region(&mut *self.model, &view, frame, &self.config.seeding)?;
        Ok(missing)
    }

    /// Moves a keyframe to where the map, as it is, looks most like its image; returns the motion,
    /// `new_world_from_old_world`, if the map shows enough of it.
    ///
    /// # Errors
    /// If the model fails.
    pub fn align(&mut self, keyframe: &mut Keyframe) -> Result<Option<Se3>, MapperError> {
        let Some(information) = keyframe.information else {
            return Ok(None);
        };
        if !self.has_views() || !self.config.tracking.color {
            return Ok(None);
        }
        let prior = PosePrior {
            world_from_camera: keyframe.world_from_camera,
            information,
        };
        let pyramid = ColorAligner::pyramid(&keyframe.frame);
        let world_from_camera = &prior.world_from_camera;
        let reference = MapReference::render(&mut *self.model, &pyramid, world_from_camera)?;
        let pose = reference.align(&pyramid, &prior);
        Ok(pose.map(|pose| {
            let motion = (pose * keyframe.world_from_camera.inverse()).renormalized();
            keyframe.world_from_camera = pose;
            motion
        }))
    }

    /// How a frame between keyframes moves to where the map, as it is, looks most like it, in its
    /// camera's axes, `old_from_new`; `None` if the map does not show enough of it.
    ///
    /// # Errors
    /// If the model fails.
    pub fn align_frame(&mut self, frame: &FrameToAlign) -> Result<Option<Se3>, MapperError> {
        if !self.has_views() {
            return Ok(None);
        }
        let FrameToAlign { pyramid, prior, .. } = frame;
        let world_from_camera = &prior.world_from_camera;
        let recent = self.state.reference.take();
        let (reference, frames) = match recent.filter(|(_, frames)| *frames < FRAMES_PER_RENDER) {
            Some(recent) => recent,
            None => {
                let model = &mut *self.model;
                let reference = MapReference::render(model, pyramid, world_from_camera)?;
                (reference, 0)
            }
        };
        let pose = reference.align(pyramid, prior);
        self.state.reference = Some((reference, frames + 1));
        let old_from_world = frame.prior.world_from_camera.inverse();
        Ok(pose.map(|pose| (old_from_world * pose).renormalized()))
    }

    /// Adds a keyframe's seeds and registers it for optimisation.
    ///
    /// # Errors
    /// If the model fails.
    pub fn insert(&mut self, prepared: PreparedKeyframe) -> Result<(), MapperError> {
        let keyframe = &prepared.keyframe;
        let id = keyframe.id;
        self.state.reference = None;
        let (seeds, max) = (&prepared.seeds, self.config.mapping.max_gaussians);
        let count = seeds.sparse_ids.len();
        self.model.make_room(count, max)?;
        self.model.insert(seeds, id)?;
        if count > max {
            self.model.make_room(0, max)?;
        }
        self.model.add_view(id, keyframe.view(), prepared.target)?;
        let covisibility = self.model.covisibility(id)?;
        (self.state.choice).set_current(id, &covisibility, MIN_COVISIBLE_SHARE, NEWEST_FIRST);
        self.state.views.push((id, keyframe.frame.index));
        let affordable = image_memory::keyframes(&keyframe.frame.camera);
        if self.state.views.len() > self.config.mapping.max_keyframes.min(affordable) {
            self.drop_most_crowded_view()?;
        }
        Ok(())
    }

    /// Whether there is a keyframe to optimise.
    pub fn has_views(&self) -> bool {
        !self.state.views.is_empty()
    }

    /// One optimisation step; nothing before the first keyframe.
    ///
    /// # Errors
    /// If the model fails.
    pub fn step(&mut self) -> Result<(), MapperError> {
        let covisible_probability = self.config.mapping.covisible_probability;
        match self.state.choice.draw(covisible_probability) {
            Some(view) => self.step_on(view),
            None => Ok(()),
        }
    }

    /// Prepares for [`refine`](Self::refine): keyframes are brought to the map's exposure. Returns
    /// them, to be drawn.
    ///
    /// # Errors
    /// If the model fails.
    pub(crate) fn begin_refinement(&mut self) -> Result<Rounds, MapperError> {
        let views: Vec<KeyframeId> = self.state.views.iter().map(|(id, _)| *id).collect();
        for id in &views {
            self.model.match_exposure(*id)?;
        }
        Ok(Rounds::new(self.config.seed, views))
    }

    /// One optimisation step like any other, whose keyframe is the next of `rounds`.
    ///
    /// # Errors
    /// If the model fails.
    pub(crate) fn refine(&mut self, rounds: &mut Rounds) -> Result<(), MapperError> {
        match rounds.draw() {
            Some(view) => self.step_on(view),
            None => Ok(()),
        }
    }

    /// Moves gaussians and views with their keyframes, each by its `new_world_from_old_world`.
    ///
    /// # Errors
    /// If the model fails.
    pub fn move_keyframes(&mut self, moves: &[(KeyframeId, Se3)]) -> Result<(), MapperError> {
        self.state.reference = None;
        Ok(self.model.move_anchored(moves)?)
    }

    /// Removes what the later side of a seam repeats of the earlier. The next steps go to the views that
    /// showed it.
    ///
    /// # Errors
    /// If the model fails.
    pub(crate) fn mend(&mut self, seam: &Seam) -> Result<(), MapperError> {
        let map = self.model.save()?;
        let repeated = seam.repeated(&map, self.config.seeding.min_alpha);
        self.state.reference = None;
        self.state.choice.draw_first(views_of(&map, &repeated));
        Ok(self.model.remove(&repeated)?)
    }

    /// How many steps were taken.
    pub fn steps(&self) -> usize {
        self.state.steps
    }

    /// How many gaussians the map has.
    pub fn num_gaussians(&self) -> usize {
        self.model.len()
    }

    /// The sparse gaussians pruned since the last call, as far as known.
    ///
    /// # Errors
    /// If the model fails.
    pub fn take_removed(&mut self) -> Result<Vec<SparseId>, MapperError> {
        Ok(self.model.take_removed()?)
    }

    /// A copy of the map.
    ///
    /// # Errors
    /// If the model fails.
    pub fn gaussians(&mut self) -> Result<Gaussians, MapperError> {
        Ok(self.model.gaussians()?)
    }

    /// Bytes that the map takes on a graphics device.
    pub fn device_bytes(&self) -> u64 {
        self.model.device_bytes()
    }

    /// The map; after a failure, as far as it is known.
    pub fn into_gaussians(self) -> Gaussians {
        self.model.into_gaussians()
    }

    /// One optimisation step with a keyframe; now and then gaussians of no use go.
    fn step_on(&mut self, view: KeyframeId) -> Result<(), MapperError> {
        self.model.step(view)?;
        // Nobody reads them yet; left in the model they would grow with the run.
        self.model.take_stats();
        self.state.steps += 1;
        if self
            .state
            .steps
            .is_multiple_of(self.config.mapping.prune_every)
        {
            self.model.prune(&PRUNE_RULE)?;
        }
        Ok(())
    }

    /// Forgets the keyframe that came soonest after its predecessor, so that those kept stay spread
    /// over the whole recording. The newest and the first stay.
    fn drop_most_crowded_view(&mut self) -> Result<(), MapperError> {
        let gap = |i: &usize| {
            self.state.views[*i]
                .1
                .0
                .abs_diff(self.state.views[*i - 1].1.0)
        };
        if let Some(crowded) = (1..self.state.views.len() - 1).min_by_key(gap) {
            let (id, _) = self.state.views.remove(crowded);
            self.state.choice.forget(id);
            self.model.drop_view(id)?;
        }
        Ok(())
    }
}
