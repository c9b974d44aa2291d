//! The mapper alone, with poses that are known.

#![allow(clippy::unwrap_used)]

mod common;

use std::sync::Arc;

use common::{config, cpu_model, room};
use fgs_geom::{FrameIndex, Image, KeyframeId, RgbdFrame, Se3};
use fgs_slam::{Keyframe, KeyframeKind, KeyframePreparer, Mapper};
use fgs_splat::Rasterizer;

fn keyframe(id: usize, frame: RgbdFrame, world_from_camera: Se3) -> Keyframe {
    Keyframe {
        id: KeyframeId(id as u32),
        kind: KeyframeKind::Mapping,
        frame: Arc::new(frame),
        world_from_camera,
        previous: None,
        information: None,
        new_points: Vec::new(),
    }
}

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
        let keyframe = keyframe(i, frame, sequence.world_from_camera(i));
        let missing = mapper.missing_region(&keyframe).unwrap();
        assert!(i > 0 || missing.data().iter().any(|missing| *missing));
        let prepared = preparer.prepare(keyframe, missing).unwrap();
        mapper.insert(prepared).unwrap();
        (0..3).for_each(|_| mapper.step().unwrap());
    }
    assert_eq!(mapper.steps(), 18);
    assert!(mapper.num_gaussians() > 1000);
}

/// A wall at two metres with a recess of which the first keyframe measures nothing.
#[test]
fn a_hole_that_is_measured_later_ends_at_its_measured_depth() {
    let camera = *room(1).camera();
    let is_hole = |u: usize, v: usize| (60..100).contains(&u) && (40..80).contains(&v);
    let config = config();
    let mut mapper = Mapper::new(cpu_model(), &config);
    let mut preparer = KeyframePreparer::new(&camera, &config);
    for (i, (recess_m, expected_m)) in [(0.0, 2.0), (2.5, 2.5)].into_iter().enumerate() {
        let depth_m = Image::from_fn(camera.width, camera.height, |u, v| {
            if is_hole(u, v) { recess_m } else { 2.0 }
        });
        let color = Image::from_fn(camera.width, camera.height, |u, v| [u as u8, v as u8, 99]);
        let frame = RgbdFrame::new(FrameIndex(i), i as f64, color, depth_m, camera).unwrap();
        let keyframe = keyframe(i, frame, Se3::identity());
        let view = keyframe.view();
        let missing = mapper.missing_region(&keyframe).unwrap();
        assert!(missing.at(80, 60));
        let prepared = preparer.prepare(keyframe, missing).unwrap();
        mapper.insert(prepared).unwrap();
        let gaussians = mapper.gaussians().unwrap();
        let mut rasterizer = Rasterizer::default();
        let rendered = rasterizer.render(&gaussians, &view).rendered().clone();
        for (u, v) in [(65, 45), (80, 60), (95, 75)] {
            let depth_m = rendered.surface_depth_m(u, v);
            assert!((depth_m - expected_m).abs() <= 0.02, "({u}, {v}) {depth_m}");
            assert!(rendered.alpha.at(u, v) > 0.5);
        }
    }
}
