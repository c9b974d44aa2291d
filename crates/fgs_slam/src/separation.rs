//! A session's sub-maps as they are given out: each in its own axes, that with the most keyframes first.

use fgs_geom::{KeyframeId, Se3};
use fgs_graph::KeyframeGraph;
use fgs_splat::Gaussians;
use nalgebra::{UnitQuaternion, Vector3};

use crate::submaps::Submaps;

/// Takes sub-maps apart.
pub struct Separation<'a> {
    submaps: &'a Submaps,
    /// The sub-maps by the number that they are given out with.
    order: Vec<usize>,
}

impl<'a> Separation<'a> {
    /// Of a session's keyframes.
    pub fn new(submaps: &'a Submaps, graph: &KeyframeGraph) -> Self {
        let order = submaps.by_size(graph.poses().map(|(id, _)| id));
        Self { submaps, order }
    }

    /// The number that the sub-map of a keyframe is given out with.
    pub fn number_of(&self, keyframe: KeyframeId) -> Option<usize> {
        let submap = self.submaps.of(keyframe)?;
        self.order.iter().position(|other| *other == submap)
    }

    /// The keyframes in the axes of their sub-maps.
    pub fn graph(&self, mut graph: KeyframeGraph) -> KeyframeGraph {
        let moves = graph.poses().filter_map(|(id, _)| {
            let origin = self.submaps.origin(self.submaps.of(id)?);
            Some((id, Se3::new(UnitQuaternion::identity(), -origin)))
        });
        let moves: Vec<_> = moves.collect();
        graph.move_keyframes(&moves);
        graph
    }

    /// The map of each sub-map in its axes, from the map of all and the session's graph.
    pub fn maps(&self, all: Gaussians, graph: &KeyframeGraph) -> Vec<Gaussians> {
        if self.order.len() <= 1 {
            return vec![all];
        }
        let boxes: Vec<_> = (self.order.iter())
            .map(|submap| Bounds::of(*submap, self.submaps, graph))
            .collect();
        let nearest = |mean: &[f32; 3]| {
            let mean = Vector3::from(mean.map(f64::from));
            let distances = boxes.iter().map(|bounds| bounds.distance_m(&mean));
            distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1))
        };
        let numbers = all.means.iter().map(|mean| nearest(mean).map(|(at, _)| at));
        let numbers: Vec<_> = numbers.collect();
        let maps = self.order.iter().enumerate().map(|(number, submap)| {
            let mut map = all.clone();
            let keep: Vec<bool> = numbers.iter().map(|of| *of == Some(number)).collect();
            map.retain(&keep);
            let origin = self.submaps.origin(*submap);
            for mean in &mut map.means {
                let moved = Vector3::from(mean.map(f64::from)) - origin;
                *mean = moved.map(|value| value as f32).into();
            }
            map
        });
        maps.collect()
    }
}

/// The box around a sub-map's keyframes.
struct Bounds {
    min: Vector3<f64>,
    max: Vector3<f64>,
}

impl Bounds {
    fn of(submap: usize, submaps: &Submaps, graph: &KeyframeGraph) -> Self {
        let poses = (graph.poses()).filter(|(id, _)| submaps.of(*id) == Some(submap));
        let nothing = Self {
            min: Vector3::repeat(f64::INFINITY),
            max: Vector3::repeat(f64::NEG_INFINITY),
        };
        poses.fold(nothing, |bounds, (_, pose)| Self {
            min: bounds.min.inf(&pose.translation),
            max: bounds.max.sup(&pose.translation),
        })
    }

    /// 0 inside.
    fn distance_m(&self, point: &Vector3<f64>) -> f64 {
        (point.sup(&self.min).inf(&self.max) - point).norm()
    }
}
