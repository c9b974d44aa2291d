//! How a session closes loops: keyframes are compared with those that the camera left long ago (loops/), and
//! what they find is worked out beside the tracker (system/correcting.rs).

use std::collections::BTreeSet;

use fgs_geom::{KeyframeId, RgbdFrame};

use super::{Slam, SlamError};
use crate::event::SlamEvent;
use crate::loops::{Correction, correction};
use crate::seam::Seam;

impl Slam {
    /// Asks a keyframe whether the camera is back where it was long ago. What has drifted since is taken out
    /// when that is worked out: at once in lockstep, otherwise before a later frame. Until then none is asked.
    pub(crate) fn find_loop(&mut self, id: KeyframeId, frame: &RgbdFrame) -> Result<(), SlamError> {
        if self.correcting.is_busy() {
            return Ok(());
        }
        self.take_moves();
        let memory = self.tracker.memory();
        let found = (self.loops).find(id, frame, &self.graph, &self.submaps, &memory);
        let Some(revisits) = found else {
            return Ok(());
        };
        let (graph, submaps) = (self.graph.clone(), self.submaps.clone());
        (self.correcting).begin(move || correction(&graph, &submaps, &revisits))?;
        self.take_correction()
    }

    /// Takes over a correction that is ready.
    pub(super) fn take_correction(&mut self) -> Result<(), SlamError> {
        let ready = self.correcting.poll();
        self.correct(ready)
    }

    /// Takes over the correction that is under way, if any.
    pub(crate) fn await_correction(&mut self) -> Result<(), SlamError> {
        let ready = self.correcting.wait();
        self.correct(ready)
    }

    fn correct(&mut self, correction: Option<Correction>) -> Result<(), SlamError> {
        let Some(mut correction) = correction else {
            return Ok(());
        };
        correction.extend_to(&self.graph);
        let seam = correction
            .edges
            .last()
            .map(|edge| Seam::between(&self.graph, &self.submaps, edge.from, edge.to));
        for edge in correction.edges {
            let (from, to) = (edge.from, edge.to);
            if self.graph.add_edge(edge).is_ok() {
                self.submaps.join(from, to);
                self.events.publish(|| SlamEvent::Loop { from, to });
            }
        }
        self.closed_loops += 1;
        if !correction.moves.is_empty() {
            self.apply(&correction.moves)?;
            if let Some(seam) = seam {
                self.mapping.mend(seam)?;
            }
        }
        self.loops.forget_what_is_known(&self.graph);
        Ok(())
    }

    /// Whether a keyframe from a number on is in a sub-map with one before it.
    pub(crate) fn has_joined(&self, begin: KeyframeId) -> bool {
        let submaps_of = |is_wanted: &dyn Fn(KeyframeId) -> bool| {
            let ids = self.graph.poses().map(|(id, _)| id);
            let ids = ids.filter(|id| is_wanted(*id));
            ids.map(|id| self.submaps.of(id)).collect::<BTreeSet<_>>()
        };
        !submaps_of(&|id| id < begin).is_disjoint(&submaps_of(&|id| id >= begin))
    }
}
