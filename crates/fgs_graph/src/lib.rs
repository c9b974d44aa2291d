//! stub
use fgs_geom::{KeyframeId, Se3};
use std::collections::BTreeMap;
/// stub
#[derive(Debug, Default, Clone)]
pub struct KeyframeGraph(BTreeMap<KeyframeId, Se3>);
#[allow(missing_docs)]
impl KeyframeGraph {
    pub fn new() -> Self {
        Self::default()
    }
    pub fn add_keyframe(&mut self, id: KeyframeId, pose: Se3) {
        self.0.insert(id, pose);
    }
    pub fn pose(&self, id: KeyframeId) -> Option<&Se3> {
        self.0.get(&id)
    }
    pub fn poses(&self) -> impl Iterator<Item = (KeyframeId, &Se3)> {
        self.0.iter().map(|(a, b)| (*a, b))
    }
    pub fn move_keyframes(&mut self, moves: &[(KeyframeId, Se3)]) {
        for (id, m) in moves {
            if let Some(p) = self.0.get_mut(id) {
                *p = *m * *p;
            }
        }
    }
}
