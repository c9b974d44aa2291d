//! Loop closure: when the camera comes back to a place after a way on which poses have drifted, the
//! place is recognised (detect.rs), checked (verify.rs), and all keyframes are moved to where the whole
//! graph fits best (correct.rs). In the same way a sub-map is joined to another that it meets; no way says
//! how the two can lie, so the check is stricter.
//!
//! A wrong loop bends the map for good, a missed one leaves it as it was. So everything must speak for
//! a loop, and two keyframes must find the same drift one after the other.
//!
//! Differs from the paper, which has no loops.

mod correct;
mod detect;
#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests;
mod verify;

use fgs_geom::{KeyframeId, RgbdFrame};
use fgs_gicp::DepthGrid;
use fgs_graph::KeyframeGraph;
use serde::{Deserialize, Serialize};

use crate::color_aligner::ColorAligner;
use crate::registrar::Registrar;
use crate::relocalizer::Relocalizer;
use crate::sparse_map::SparseMap;
use crate::submaps::Submaps;

pub use correct::{Correction, correction, successive_edge};
use correct::{agree, are_close};
use detect::{Ways, candidates, candidates_apart};
pub use verify::seen_by_both;
use verify::{LOOP, MEETING, Revisit, Seen, verify};

/// A revisit waits for another to agree while the camera comes so far, metres.
const PATIENCE_M: f64 = 2.0;

/// What is remembered of all keyframes.
#[derive(Clone, Copy)]
pub struct Memory<'a> {
    pub places: &'a Relocalizer,
    pub color: &'a ColorAligner,
    pub map: &'a SparseMap,
    pub grid: &'a DepthGrid,
    pub registrar: &'a Registrar,
}

/// Finds loops, keyframe by keyframe.
#[derive(Clone, Default, Serialize, Deserialize)]
pub struct LoopCloser {
    /// Revisits that nothing has confirmed yet.
    waiting: Vec<Revisit>,
}

impl LoopCloser {
    /// Whether a keyframe that joined the graph shows a place that was left long ago. Mostly it does not; if it
    /// and another before it have found the same drift, both revisits are returned, and how the keyframes should
    /// move is for [`correction`] to say.
    pub fn find(
        &mut self,
        id: KeyframeId,
        frame: &RgbdFrame,
        graph: &KeyframeGraph,
        submaps: &Submaps,
        memory: &Memory,
    ) -> Option<[Revisit; 2]> {
        let ways = Ways::from(graph, id);
        (self.waiting).retain(|revisit| {
            let way = ways.to(revisit.new).min(ways.to(revisit.old));
            // Nothing tells how far a camera has come that has been lost.
            way <= PATIENCE_M || way.is_infinite()
        });
        if let Some(both) = self.returned(id, graph, &ways, memory) {
            return Some(both);
        }
        let similar = memory.places.similar_to(frame);
        let candidates = candidates(id, &similar, &ways, graph, memory);
        let apart = candidates_apart(id, &similar, submaps);
        if candidates.is_empty() && apart.is_empty() {
            return None;
        }
        let pyramid = ColorAligner::pyramid(frame);
        let seen = Seen {
            id,
            frame,
            pyramid: &pyramid,
        };
        let is_drift = |revisit: &Revisit, chi2| revisit.is_news(graph, &ways, chi2);
        let revisit = verify(seen, &apart, &MEETING, |_, _| true, graph, memory)
            .or_else(|| verify(seen, &candidates, &LOOP, is_drift, graph, memory))?;
        let confirmed = (self.waiting.iter()).find(|earlier| agree(earlier, &revisit, graph));
        let both = confirmed.map(|earlier| [earlier.clone(), revisit.clone()]);
        self.waiting.push(revisit);
        both
    }

    /// Whether a keyframe confirms a revisit from the other side: a camera that drift or a loss has torn from its
    /// way is where the old keyframe was taken, and sees what the new one saw, where the revisit says.
    fn returned(
        &self,
        id: KeyframeId,
        graph: &KeyframeGraph,
        ways: &Ways,
        memory: &Memory,
    ) -> Option<[Revisit; 2]> {
        self.waiting.iter().find_map(|revisit| {
            if ways.to(revisit.old) > PATIENCE_M || !ways.is_old(revisit.new) {
                return None;
            }
            let seen = seen_by_both(revisit.new, id, memory.places)?;
            let world_from_new = *graph.pose(revisit.old)? * revisit.old_from_new;
            let expected = world_from_new.inverse() * *graph.pose(id)?;
            are_close(&seen.old_from_new, &expected).then(|| [revisit.clone(), seen])
        })
    }

    /// A loop has been closed, and keyframes have moved: what is no news any more waits no longer.
    pub fn forget_what_is_known(&mut self, graph: &KeyframeGraph) {
        self.waiting.retain(|revisit| revisit.contradicts(graph));
    }
}
