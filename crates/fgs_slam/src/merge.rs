//! Two finished maps of one place become one: they are put side by side as sub-maps (submaps.rs), and every
//! keyframe of the second is asked whether it shows what the first shows, as one that has just joined
//! (loops/).
//!
//! Differs from the paper, whose maps end with their run.

use fgs_geom::{KeyframeId, RgbdFrame, Se3};
use fgs_splat::{GaussianModel, SparseId};
use nalgebra::{UnitQuaternion, Vector3};

use crate::config::SlamConfig;
use crate::saved_session::SavedSession;
use crate::session::{Slam, SlamError};
use crate::submaps::APART_M;
use crate::system::Execution;

/// What numbers of a map become in another that has taken it in.
#[derive(Clone, Copy)]
pub struct Renumbering {
    /// The number of its keyframe 0.
    pub keyframes: u32,
    /// The number of its sparse point 0.
    pub sparse: u32,
}

impl Renumbering {
    pub fn keyframe(self, id: KeyframeId) -> KeyframeId {
        KeyframeId(id.0.saturating_add(self.keyframes))
    }

    pub fn sparse(self, id: SparseId) -> SparseId {
        SparseId(id.0.saturating_add(self.sparse))
    }
}

impl Slam {
    /// A session in the map that two maps become, as if it had seen both; its camera is lost. The second's
    /// keyframes are numbered on from the first's. `None` if they meet nowhere. The model must be empty.
    /// `image_of` gives the images of a keyframe of the first map (0) or the second (1), by its number there;
    /// those of the second are asked for twice.
    ///
    /// # Errors
    /// [`SlamError::OtherCameras`] if the maps' cameras differ; otherwise as [`restore`](Self::restore).
    pub fn merged<E: From<SlamError>>(
        config: &SlamConfig,
        execution: Execution,
        model: Box<dyn GaussianModel>,
        maps: [SavedSession; 2],
        mut image_of: impl FnMut(usize, KeyframeId) -> Result<RgbdFrame, E>,
    ) -> Result<Option<Self>, E> {
        let [first, second] = maps.map(SavedSession::into_map);
        let Some(begin) = first.next_keyframe() else {
            return Ok(None);
        };
        let away = away_from(&first, &second);
        let both = first.beside(second, away.translation)?;
        let place_of = |id: KeyframeId| match id.0.checked_sub(begin.0) {
            Some(number) => (1, KeyframeId(number)),
            None => (0, id),
        };
        let mut slam = Self::restore(config, execution, model, both, |id| {
            let (map, id) = place_of(id);
            image_of(map, id)
        })?;
        slam.take_moves();
        let new = slam.graph().poses().map(|(id, _)| id);
        let new: Vec<_> = new.filter(|id| *id >= begin).collect();
        let apart: Vec<_> = new.iter().map(|id| (*id, away)).collect();
        slam.move_keyframes(&apart)?;
        for id in &new {
            let (map, number) = place_of(*id);
            let frame = image_of(map, number)?;
            slam.find_loop(*id, &frame)?;
            slam.await_correction()?;
        }
        Ok(slam.has_joined(begin).then_some(slam))
    }
}

/// The motion that takes all that a map has seen far above all that another has.
fn away_from(first: &SavedSession, second: &SavedSession) -> Se3 {
    let heights = |map: &SavedSession| {
        let heights = map.graph.poses().map(|(_, pose)| -pose.translation.y);
        heights.collect::<Vec<f64>>()
    };
    let highest = heights(first).into_iter().fold(f64::NEG_INFINITY, f64::max);
    let lowest = heights(second).into_iter().fold(f64::INFINITY, f64::min);
    let up = highest + APART_M - lowest;
    Se3::new(UnitQuaternion::identity(), Vector3::new(0.0, -up, 0.0))
}
