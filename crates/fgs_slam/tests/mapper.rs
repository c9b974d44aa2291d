//! The mapper alone, with poses that are known.

#![allow(clippy::unwrap_used)]

mod common;

use std::sync::Arc;

use common::{config, cpu_model, room};
use fgs_geom::{FrameIndex, KeyframeId};
use fgs_slam::{Keyframe, KeyframeKind, KeyframePreparer, Mapper};

/// Frame numbers come from outside and may go back, for example where a camera was restarted.
#[test]
fn keyframes_beyond_the_limit_are_dropped_whatever_their_order() {
    let sequence = room(6);
    let mut config = config();
    config.mapping.max_keyframes = 3;
    let mut mapper = Mapper::new(cpu_model(), &config);
    let mut preparer = KeyframePreparer::new(sequence.camera(), &config);
    for (i, index) in [7, 3, 9, 0, 8, 2].into_iter().enumerate() {
        let mut frame = sequence.frame(i);
        frame.index = FrameIndex(index);
        let keyframe = Keyframe {
            id: KeyframeId(i as u32),
            kind: KeyframeKind::Mapping,
            frame: Arc::new(frame),
            world_from_camera: sequence.world_from_camera(i),
            information: None,
            new_points: Vec::new(),
        };
        let missing = mapper.missing_region(&keyframe).unwrap();
        assert!(i > 0 || missing.data().iter().any(|missing| *missing));
        let prepared = preparer.prepare(keyframe, &missing).unwrap();
        mapper.insert(prepared).unwrap();
        (0..3).for_each(|_| mapper.step().unwrap());
    }
    assert_eq!(mapper.steps(), 18);
    assert!(mapper.num_gaussians() > 1000);
}
