//! Loop closure on frames of synthetic rooms, with drift that is known.

use std::sync::Arc;

use fgs_geom::Se3;
use fgs_synth::{SensorModel, Sequence, kinect_camera};
use nalgebra::{Matrix6, Vector6};

use super::*;
use crate::config::SlamConfig;
use crate::keyframes::{Keyframe, KeyframeKind};
use crate::sparse_map::SavedSparseMap;
use crate::surface::tracking_grid;

/// What a tracker would remember.
struct Remembered {
    graph: KeyframeGraph,
    submaps: Submaps,
    places: Relocalizer,
    color: ColorAligner,
    map: SparseMap,
    grid: DepthGrid,
    registrar: Registrar,
}

fn sequence(seed: u64) -> Sequence {
    Sequence::new(
        seed,
        300,
        kinect_camera(320, 240).unwrap(),
        SensorModel::kinect(),
    )
}

fn drift() -> Se3 {
    Se3::exp(&Vector6::new(0.02, -0.03, 0.01, 0.05, 0.03, -0.06))
}

impl Remembered {
    /// Keyframes 0 to 3 where the first frames of a room were taken, and a way of metres from there, to
    /// keyframe 4.
    fn new(sequence: &Sequence) -> Self {
        let config = SlamConfig::default();
        let mut remembered = Self {
            graph: KeyframeGraph::new(),
            submaps: Submaps::default(),
            places: Relocalizer::default(),
            color: ColorAligner::default(),
            map: SparseMap::restored(0.03, SavedSparseMap::default()),
            grid: tracking_grid(&config, sequence.camera()),
            registrar: Registrar::new(&config),
        };
        for i in 0..4_u32 {
            let before = i.checked_sub(1);
            remembered.show(i, before, sequence, 4 * i as usize, &Se3::identity());
        }
        let far = Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 9.0, 0.0, 0.0));
        remembered.join(4, Some(3), far);
        remembered
    }

    /// A keyframe joins the graph, tracked from another.
    fn join(&mut self, id: u32, before: Option<u32>, pose: Se3) {
        let (id, before) = (KeyframeId(id), before.map(KeyframeId));
        self.graph.add_keyframe(id, pose);
        self.submaps.add(id, before, pose.translation);
        if let Some(from) = before
            && let Some(world_from_before) = self.graph.pose(from)
        {
            let motion = world_from_before.inverse() * pose;
            let information = Matrix6::identity() * 1e6;
            let edge = successive_edge(from, id, motion, &information, None);
            self.graph.add_edge(edge.unwrap()).unwrap();
        }
    }

    /// A keyframe is made of a frame, whose pose is said to be off by some drift.
    fn show(
        &mut self,
        id: u32,
        before: Option<u32>,
        sequence: &Sequence,
        frame: usize,
        drift: &Se3,
    ) -> Keyframe {
        let pose = *drift * sequence.world_from_camera(frame);
        let keyframe = Keyframe {
            id: KeyframeId(id),
            kind: KeyframeKind::Tracking,
            frame: Arc::new(sequence.frame(frame)),
            world_from_camera: pose,
            previous: None,
            information: None,
            new_points: Vec::new(),
        };
        self.join(id, before, pose);
        self.places.add(&keyframe);
        let frame = &keyframe.frame;
        self.color.add(&keyframe, &ColorAligner::pyramid(frame));
        let surface = self.grid.surface_points(&frame.depth_m, &frame.camera);
        let disks = surface
            .iter()
            .map(|point| self.registrar.disk(point).transformed(&pose));
        let disks: Vec<_> = disks.collect();
        self.map.extend(keyframe.id, &disks, 0.015);
        keyframe
    }

    fn memory(&self) -> Memory<'_> {
        Memory {
            places: &self.places,
            color: &self.color,
            map: &self.map,
            grid: &self.grid,
            registrar: &self.registrar,
        }
    }

    /// Shows a frame, tracked from the one before it, and looks for loops.
    fn close(
        &mut self,
        closer: &mut LoopCloser,
        id: u32,
        sequence: &Sequence,
        frame: usize,
        drift: &Se3,
    ) -> Option<Correction> {
        let keyframe = self.show(id, id.checked_sub(1), sequence, frame, drift);
        self.find(closer, &keyframe)
    }

    fn find(&self, closer: &mut LoopCloser, keyframe: &Keyframe) -> Option<Correction> {
        let (graph, submaps) = (&self.graph, &self.submaps);
        let revisits = closer.find(keyframe.id, &keyframe.frame, graph, submaps, &self.memory())?;
        correction(graph, submaps, &revisits)
    }
}

#[test]
fn two_revisits_that_agree_take_out_the_drift() {
    let sequence = sequence(3);
    let mut remembered = Remembered::new(&sequence);
    let mut closer = LoopCloser::default();
    let first = remembered.close(&mut closer, 5, &sequence, 2, &drift());
    assert!(first.is_none() && closer.waiting.len() == 1);
    let closed = remembered
        .close(&mut closer, 6, &sequence, 6, &drift())
        .unwrap();
    assert_eq!(closed.edges.len(), 2);
    let (_, motion) = closed.moves.last().unwrap();
    let left =
        sequence.world_from_camera(6).inverse() * *motion * drift() * sequence.world_from_camera(6);
    let before = sequence.world_from_camera(6).inverse() * drift() * sequence.world_from_camera(6);
    assert!(before.rotation.angle() >= 0.03, "{before:?}");
    assert!(
        left.translation.norm() <= 0.01 && left.rotation.angle() <= 0.005,
        "{left:?}"
    );
    // The first keyframe stays; those before the way hardly move.
    for (id, motion) in &closed.moves[..4] {
        let moved = motion.log().norm();
        assert!(moved <= 0.01, "{id:?}: {moved}");
    }
}

/// The camera is lost after the first revisit, and found where it was at first.
#[test]
fn a_revisit_is_confirmed_by_who_is_back_another_way() {
    let sequence = sequence(3);
    let mut remembered = Remembered::new(&sequence);
    let mut closer = LoopCloser::default();
    let first = remembered.close(&mut closer, 5, &sequence, 2, &drift());
    assert!(first.is_none() && closer.waiting.len() == 1);
    let found = remembered.show(6, Some(1), &sequence, 6, &Se3::identity());
    let closed = remembered.find(&mut closer, &found).unwrap();
    let (_, motion) = closed.moves[5];
    let left =
        sequence.world_from_camera(2).inverse() * motion * drift() * sequence.world_from_camera(2);
    assert!(
        left.translation.norm() <= 0.02 && left.rotation.angle() <= 0.01,
        "{left:?}"
    );
    // Once the graph knows, nothing waits.
    remembered.graph.move_keyframes(&closed.moves);
    closer.forget_what_is_known(&remembered.graph);
    assert!(closer.waiting.is_empty());
}

#[test]
fn revisits_that_disagree_close_nothing() {
    let sequence = sequence(3);
    let mut remembered = Remembered::new(&sequence);
    let mut closer = LoopCloser::default();
    let first = remembered.close(&mut closer, 5, &sequence, 2, &drift());
    let other = Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, -0.08, 0.0));
    let second = remembered.close(&mut closer, 6, &sequence, 6, &other);
    assert!(first.is_none() && second.is_none());
    assert_eq!(closer.waiting.len(), 2);
}

#[test]
fn what_the_graph_knows_is_no_news() {
    let sequence = sequence(3);
    let mut remembered = Remembered::new(&sequence);
    let mut closer = LoopCloser::default();
    for (id, frame) in [(5, 2), (6, 6), (7, 10)] {
        let closed = remembered.close(&mut closer, id, &sequence, frame, &Se3::identity());
        assert!(closed.is_none() && closer.waiting.is_empty());
    }
}

/// The same room again, but farther away than anything drifts.
#[test]
fn a_look_alike_elsewhere_is_refused() {
    let sequence = sequence(3);
    let mut remembered = Remembered::new(&sequence);
    let mut closer = LoopCloser::default();
    let elsewhere = Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, 5.6, 0.0));
    for (id, frame) in [(5, 2), (6, 6)] {
        let closed = remembered.close(&mut closer, id, &sequence, frame, &elsewhere);
        assert!(closed.is_none() && closer.waiting.is_empty());
    }
}

/// Other rooms where the first one should be.
#[test]
fn an_unrelated_place_is_refused() {
    let known = sequence(3);
    for seed in 4..7 {
        let mut remembered = Remembered::new(&known);
        let mut closer = LoopCloser::default();
        let other = sequence(seed);
        for (id, frame) in [(5, 2), (6, 6)] {
            let apart = known.world_from_camera(frame) * other.world_from_camera(frame).inverse();
            let closed = remembered.close(&mut closer, id, &other, frame, &(drift() * apart));
            assert!(closed.is_none() && closer.waiting.is_empty(), "{seed}");
        }
    }
}
