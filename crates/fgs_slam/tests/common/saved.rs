//! What a saved session leaves behind, in memory.

use std::collections::BTreeMap;

use fgs_geom::{KeyframeId, RgbdFrame};
use fgs_slam::{Execution, SavedSession, Slam, SlamConfig, SlamError};
use fgs_splat::GaussianModel;

/// What a session leaves behind: its state as bytes, and its keyframes' images.
#[derive(Default)]
pub struct Folder {
    pub state: Vec<u8>,
    images: BTreeMap<KeyframeId, Vec<u8>>,
}

impl Folder {
    pub fn save(&mut self, slam: &mut Slam) {
        for (id, frame) in slam.take_new_keyframes() {
            (self.images).insert(id, postcard::to_stdvec(&*frame).unwrap());
        }
        self.state = postcard::to_stdvec(&slam.save().unwrap()).unwrap();
    }

    pub fn saved(&self) -> SavedSession {
        postcard::from_bytes(&self.state).unwrap()
    }

    pub fn image(&self, id: KeyframeId) -> Result<RgbdFrame, SlamError> {
        let image = self.images.get(&id).ok_or(SlamError::Inconsistent)?;
        Ok(postcard::from_bytes(image).unwrap())
    }

    pub fn restored(
        &self,
        config: &SlamConfig,
        execution: Execution,
        model: Box<dyn GaussianModel>,
        saved: SavedSession,
    ) -> Slam {
        let mut slam = Slam::restore(config, execution, model, saved, |id| self.image(id)).unwrap();
        slam.keep_new_keyframes();
        slam
    }
}
