//! Colour in tracking: a frame was taken where keyframes look as bright as the frame does. Where
//! geometry slides (a wall with posters) colour holds, and the map's colours stay sharp.

use std::collections::{BTreeMap, VecDeque};

use fgs_direct::{
    Agreement, IntensityPyramid, PhotometricAlignment, PosePrior, PosedReference, Reference,
    ReferencePoint, agreement, align_with_keyframes, contrast,
};
use fgs_geom::{Image, KeyframeId, RgbdFrame, Se3};

use crate::keyframes::{Keyframe, Motions};

/// Levels of the pyramid, the frame itself included: at the coarsest, a pixel is eight.
const LEVELS: usize = 4;

/// So many keyframes are kept to align with.
const MAX_KEYFRAMES: usize = 64;

/// The level at which frames are compared with keyframes, a quarter of the full resolution: blur and
/// a pixel's misalignment are no disagreement.
const AGREEMENT_LEVEL: usize = 1;

/// A finer level is compared if there are fewer points.
const MIN_REFERENCE_POINTS: usize = 80;

/// A keyframe shares enough with a frame to judge it if this share of its points is seen there.
const MIN_SHARED: f64 = 0.2;

/// With less of it in view, the newest keyframe is left behind.
const LEFT_BEHIND: f64 = 0.4;

/// An older keyframe is aligned with if at least this share of its points is in view.
const MIN_OVERLAP: f64 = 0.6;

/// Aligns frames with keyframes by their brightness.
#[derive(Default)]
pub struct ColorAligner {
    /// In the order they came.
    keyframes: VecDeque<ReferenceKeyframe>,
    /// The points by which a frame is compared with a keyframe, however old, and their level.
    compared: BTreeMap<KeyframeId, (usize, Vec<ReferencePoint>)>,
}

struct ReferenceKeyframe {
    id: KeyframeId,
    world_from_camera: Se3,
    reference: Reference,
}

impl ColorAligner {
    /// A frame's brightness at the resolutions that are aligned, from the half on: at full resolution
    /// noise and the sensor's own interpolation outweigh what is gained.
    pub fn pyramid(frame: &RgbdFrame) -> IntensityPyramid {
        let mut pyramid = IntensityPyramid::of_frame(frame, LEVELS);
        if pyramid.levels.len() > 1 {
            pyramid.levels.remove(0);
        }
        pyramid
    }

    /// The pose of a frame, given what geometry knows of it; `None` if too little is in view.
    pub fn align(
        &self,
        pyramid: &IntensityPyramid,
        prior: &PosePrior,
    ) -> Option<PhotometricAlignment> {
        let chosen = self.choose(pyramid, &prior.world_from_camera);
        let references: Vec<_> = chosen
            .map(|keyframe| PosedReference {
                reference: &keyframe.reference,
                world_from_reference: keyframe.world_from_camera,
            })
            .collect();
        align_with_keyframes(pyramid, &references, prior)
    }

    /// How well a frame at a pose agrees with the newest keyframe or, if the two share too little, with
    /// the keyframe that shares most with it. (Poses drift, so that older keyframes agree less.) `None`
    /// without keyframes.
    pub fn agreement(
        &self,
        pyramid: &IntensityPyramid,
        depth_m: &Image<f32>,
        world_from_camera: &Se3,
    ) -> Option<Agreement> {
        let newest = self.keyframes.back()?;
        let level = agreement_level(&newest.reference);
        let image = pyramid.levels.get(level)?;
        let contrast = contrast(pyramid.levels.last()?);
        let with = |keyframe: &ReferenceKeyframe| {
            Some(agreement(
                image,
                depth_m,
                contrast,
                keyframe.reference.levels.get(level)?,
                &(world_from_camera.inverse() * keyframe.world_from_camera),
            ))
        };
        let newest = with(newest)?;
        if newest.share >= MIN_SHARED {
            return Some(newest);
        }
        self.keyframes
            .iter()
            .filter_map(with)
            .max_by(|a, b| a.share.total_cmp(&b.share))
    }

    /// How well a frame agrees with a keyframe, given their relative pose; `None` if that is unknown.
    pub fn agreement_with(
        &self,
        keyframe: KeyframeId,
        pyramid: &IntensityPyramid,
        depth_m: &Image<f32>,
        camera_from_keyframe: &Se3,
    ) -> Option<Agreement> {
        let (level, points) = self.compared.get(&keyframe)?;
        Some(agreement(
            pyramid.levels.get(*level)?,
            depth_m,
            contrast(pyramid.levels.last()?),
            points,
            camera_from_keyframe,
        ))
    }

    /// Whether a camera hardly sees what the newest keyframe shows.
    pub fn has_left_newest(&self, pyramid: &IntensityPyramid, world_from_camera: &Se3) -> bool {
        let newest = self.keyframes.back();
        newest.is_some_and(|newest| newest.share_in_view(pyramid, world_from_camera) < LEFT_BEHIND)
    }

    /// The newest keyframe, and the oldest of which enough is in view: the one is most alike, the
    /// other keeps errors from adding up.
    fn choose(
        &self,
        pyramid: &IntensityPyramid,
        world_from_camera: &Se3,
    ) -> impl Iterator<Item = &ReferenceKeyframe> {
        let newest = self.keyframes.len().saturating_sub(1);
        let oldest = self
            .keyframes
            .iter()
            .take(newest)
            .find(|keyframe| keyframe.share_in_view(pyramid, world_from_camera) >= MIN_OVERLAP);
        self.keyframes.back().into_iter().chain(oldest)
    }

    /// Takes a keyframe; its depth image must be registered to its colour image.
    pub fn add(&mut self, keyframe: &Keyframe, pyramid: &IntensityPyramid) {
        let frame = &keyframe.frame;
        let reference = Reference::new(pyramid, &frame.depth_m, &frame.camera);
        let level = agreement_level(&reference);
        if let Some(points) = reference.levels.get(level) {
            (self.compared).insert(keyframe.id, (level, points.clone()));
        }
        self.keyframes.push_back(ReferenceKeyframe {
            id: keyframe.id,
            world_from_camera: keyframe.world_from_camera,
            reference,
        });
        if self.keyframes.len() > MAX_KEYFRAMES {
            self.keyframes.pop_front();
        }
    }

    /// Forgets by which points a frame is compared with a keyframe.
    pub fn forget(&mut self, id: KeyframeId) {
        self.compared.remove(&id);
    }

    /// Keyframes were moved.
    pub fn move_keyframes(&mut self, motions: &Motions) {
        for keyframe in &mut self.keyframes {
            motions.apply(keyframe.id, &mut keyframe.world_from_camera);
        }
    }
}

/// The level at which frames are compared with a keyframe: small images have too few points at a quarter of their
/// size.
fn agreement_level(reference: &Reference) -> usize {
    let has_enough = |level: &usize| {
        let points = reference.levels.get(*level);
        points.is_some_and(|points| points.len() >= MIN_REFERENCE_POINTS)
    };
    (0..=AGREEMENT_LEVEL).rev().find(has_enough).unwrap_or(0)
}

impl ReferenceKeyframe {
    /// How much of the keyframe a camera sees.
    fn share_in_view(&self, pyramid: &IntensityPyramid, world_from_camera: &Se3) -> f64 {
        let Some((image, points)) = pyramid
            .levels
            .iter()
            .zip(&self.reference.levels)
            .next_back()
        else {
            return 0.0;
        };
        let camera_from_reference = world_from_camera.inverse() * self.world_from_camera;
        let seen = points.iter().filter(|point| {
            let pixel = (image.camera).project(&camera_from_reference.transform(&point.position));
            pixel.is_some_and(|pixel| image.camera.contains(&pixel))
        });
        seen.count() as f64 / points.len().max(1) as f64
    }
}
