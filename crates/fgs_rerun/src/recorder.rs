//! Writes what there is to see into a stream of Rerun's.

use std::collections::BTreeMap;

use fgs_data::Trajectory;
use fgs_export::unit_quat;
use fgs_geom::{Camera, KeyframeId, Se3};
use fgs_slam::{Addition, FrameResult, FrameStatus, KeyframeKind};
use fgs_splat::Gaussians;
use fgs_view::{Audience, Picture, Render, SiteKeyframe, picture_camera};
use nalgebra::Vector3;
use re_sdk::{AsComponents, RecordingStream, RecordingStreamError, RecordingStreamResult};
use re_sdk_types::archetypes::{
    EncodedImage, GaussianSplats3D, LineStrips3D, Pinhole, Scalars, TextLog, Transform3D,
    ViewCoordinates,
};
use re_sdk_types::components::{Color, TextLogLevel};
use re_sdk_types::datatypes::Quaternion;

use crate::growth::Growth;
use crate::view::Outcome;

/// The timeline of frame numbers.
pub const FRAME: &str = "frame";
/// That of seconds since the first frame.
const TIME: &str = "time";

/// What is plotted.
pub const PLOTS: [&str; 7] = [
    "tracking_ms",
    "uncertainty_mm",
    "residual_mm",
    "inliers",
    "gaussians",
    "steps",
    "psnr_db",
];

/// A picture that is not the camera's image.
#[derive(Clone, Copy)]
pub struct NamedPicture {
    picture: Picture,
    pub name: &'static str,
}

/// All of those.
pub const PICTURES: [NamedPicture; 4] = [
    NamedPicture {
        picture: Picture::Render,
        name: "render",
    },
    NamedPicture {
        picture: Picture::Depth,
        name: "depth",
    },
    NamedPicture {
        picture: Picture::RenderedDepth,
        name: "rendered_depth",
    },
    NamedPicture {
        picture: Picture::Addition,
        name: "added",
    },
];

const CAMERA: &str = "world/camera";
const TRACKING_COLOR: [u8; 3] = [246, 170, 92];
const MAPPING_COLOR: [u8; 3] = [56, 152, 255];
const EDGE_COLOR: [u8; 3] = [130, 130, 130];
const LOOP_COLOR: [u8; 3] = [222, 60, 84];
const ESTIMATED_COLOR: [u8; 3] = [90, 200, 120];
const REFERENCE_COLOR: [u8; 3] = [240, 240, 240];
/// How far from a camera its image is drawn, metres.
const CAMERA_SIZE_M: f32 = 0.25;
const KEYFRAME_SIZE_M: f32 = 0.06;

/// Where a picture is.
pub fn picture_path(picture: NamedPicture) -> String {
    format!("pictures/{}", picture.name)
}

/// Where the camera's image is.
pub fn input_path() -> String {
    format!("{CAMERA}/image")
}

struct Keyframe {
    kind: KeyframeKind,
    world_from_camera: Se3,
    submap: Option<usize>,
}

/// A frame that was seen.
struct Seen {
    index: usize,
    secs: f64,
    /// Its position in a keyframe's axes: it moves with it.
    position: Option<(usize, Vector3<f64>)>,
}

/// Writes a run into a stream.
pub struct Recorder {
    stream: RecordingStream,
    camera: Camera,
    /// By the numbers of their frames.
    keyframes: BTreeMap<usize, Keyframe>,
    frame_of: BTreeMap<KeyframeId, usize>,
    frames: Vec<Seen>,
    loops: Vec<[KeyframeId; 2]>,
    status: Option<FrameStatus>,
    map_growth: Growth,
    way_growth: Growth,
    graph_growth: Growth,
    /// The first thing that could not be written.
    failure: Option<RecordingStreamError>,
}

impl Recorder {
    /// Of a run whose camera is `camera`.
    pub fn new(stream: RecordingStream, camera: &Camera) -> RecordingStreamResult<Self> {
        let camera = picture_camera(camera);
        stream.set_log_tick_enabled(false);
        stream.set_log_time_enabled(false);
        stream.log_static("world", &ViewCoordinates::RDF())?;
        let pinhole = pinhole(&camera, CAMERA_SIZE_M);
        stream.log_static(input_path(), &pinhole)?;
        Ok(Self {
            stream,
            camera,
            keyframes: BTreeMap::new(),
            frame_of: BTreeMap::new(),
            frames: Vec::new(),
            loops: Vec::new(),
            status: None,
            map_growth: Growth::default(),
            way_growth: Growth::default(),
            graph_growth: Growth::default(),
            failure: None,
        })
    }

    /// Writes what is known at the end, and returns the stream.
    pub fn end(mut self, outcome: Option<&Outcome<'_>>) -> RecordingStreamResult<RecordingStream> {
        self.now();
        if let Some(outcome) = outcome {
            self.show(outcome);
        }
        self.draw_graph();
        self.failure.map_or(Ok(self.stream), Err)
    }

    fn show(&mut self, outcome: &Outcome<'_>) {
        for keyframe in outcome.keyframes {
            self.conclude_keyframe(keyframe);
        }
        self.log("world/map", &splats(outcome.map));
        let way = |trajectory: &Trajectory| -> Vec<Vector3<f64>> {
            let poses = trajectory.poses().iter();
            poses
                .map(|pose| pose.world_from_camera.translation)
                .collect()
        };
        self.log(
            "world/trajectory",
            &lines([way(outcome.trajectory)], ESTIMATED_COLOR),
        );
        if let Some(reference) = outcome.reference {
            let reference = lines([way(reference)], REFERENCE_COLOR);
            if let Err(error) = self.stream.log_static("world/reference", &reference) {
                self.failure.get_or_insert(error);
            }
        }
    }

    fn log(&mut self, path: impl Into<re_sdk::EntityPath>, what: &dyn AsComponents) {
        if let Err(error) = self.stream.log(path, what) {
            self.failure.get_or_insert(error);
        }
    }

    fn plot(&mut self, name: &str, value: Option<f64>) {
        debug_assert!(PLOTS.contains(&name));
        if let Some(value) = value {
            self.log(format!("plots/{name}"), &Scalars::single(value));
        }
    }

    /// What follows belongs to the frame of some place among those seen.
    fn at(&self, place: usize) {
        if let (Some(first), Some(frame)) = (self.frames.first(), self.frames.get(place)) {
            let index = i64::try_from(frame.index).unwrap_or(i64::MAX);
            self.stream.set_time_sequence(FRAME, index);
            self.stream.set_duration_secs(TIME, frame.secs - first.secs);
        }
    }

    /// What follows belongs to the newest frame.
    fn now(&self) {
        self.at(self.frames.len().saturating_sub(1));
    }

    /// What follows belongs to the frame of some number.
    fn at_frame(&self, index: usize) {
        self.at(self.frames.partition_point(|frame| frame.index < index));
    }

    fn put_keyframe(&mut self, frame: usize) {
        if let Some(keyframe) = self.keyframes.get(&frame) {
            let pose = transform(&keyframe.world_from_camera);
            self.log(keyframe_path(frame, keyframe.kind), &pose);
        }
    }

    fn add_keyframe(&mut self, frame: usize, keyframe: Keyframe) {
        let color = match keyframe.kind {
            KeyframeKind::Tracking => TRACKING_COLOR,
            KeyframeKind::Mapping => MAPPING_COLOR,
        };
        let path = keyframe_path(frame, keyframe.kind);
        self.keyframes.insert(frame, keyframe);
        self.put_keyframe(frame);
        let frustum = pinhole(&self.camera, KEYFRAME_SIZE_M).with_color(color);
        self.log(path, &frustum);
    }

    /// Takes over a keyframe's final pose. The last frame became one after all had been told of it.
    fn conclude_keyframe(&mut self, conclusion: &SiteKeyframe) {
        let (frame, world_from_camera) = (conclusion.index, conclusion.world_from_camera);
        if let Some(keyframe) = self.keyframes.get_mut(&frame) {
            keyframe.world_from_camera = world_from_camera;
            self.put_keyframe(frame);
        } else if let Some(kind) = conclusion.kind {
            let before = self.keyframes.range(..frame).next_back();
            let submap = before.and_then(|(_, keyframe)| keyframe.submap);
            let keyframe = Keyframe {
                kind,
                world_from_camera,
                submap,
            };
            self.add_keyframe(frame, keyframe);
        }
    }

    /// Draws what connects the keyframes.
    fn draw_graph(&mut self) {
        let keyframes: Vec<&Keyframe> = self.keyframes.values().collect();
        let together = |pair: &&[&Keyframe]| pair[0].submap == pair[1].submap;
        let edge = |pair: &[&Keyframe]| {
            let [a, b] = [pair[0], pair[1]].map(|keyframe| keyframe.world_from_camera.translation);
            vec![a, b]
        };
        let edges = lines(keyframes.windows(2).filter(together).map(edge), EDGE_COLOR);
        let position = |id: &KeyframeId| {
            let keyframe = self.keyframes.get(self.frame_of.get(id)?)?;
            Some(keyframe.world_from_camera.translation)
        };
        let loops = self.loops.iter();
        let loops = loops.filter_map(|[from, to]| Some(vec![position(from)?, position(to)?]));
        let loops = lines(loops, LOOP_COLOR);
        self.log("world/graph/edges", &edges);
        self.log("world/graph/loops", &loops);
    }

    /// Draws the way so far.
    fn draw_way(&mut self) {
        let positions = self.frames.iter().filter_map(|frame| {
            let (keyframe, position) = frame.position.as_ref()?;
            let keyframe = self.keyframes.get(keyframe)?;
            Some(keyframe.world_from_camera.transform(position))
        });
        let way = lines([positions.collect()], ESTIMATED_COLOR);
        self.log("world/trajectory", &way);
    }
}

impl Audience for Recorder {
    fn is_watching(&self) -> bool {
        true
    }

    fn frame(
        &mut self,
        result: &FrameResult,
        error: Option<&str>,
        num_gaussians: usize,
        steps: usize,
    ) {
        let pose = result.world_from_camera;
        let keyframe = result.keyframe.zip(pose);
        // A keyframe is the anchor of its own frame.
        let anchor = match keyframe {
            Some((_, pose)) => Some((result.index.0, pose)),
            None => (self.keyframes.last_key_value())
                .map(|(frame, keyframe)| (*frame, keyframe.world_from_camera)),
        };
        let position = anchor
            .zip(pose)
            .map(|((id, keyframe), pose)| (id, keyframe.inverse().transform(&pose.translation)));
        let before = self.frames.last().map_or(0.0, |frame| frame.secs);
        self.frames.push(Seen {
            index: result.index.0,
            secs: result.timestamp_secs.unwrap_or(before),
            position,
        });
        self.now();
        if let Some(pose) = &pose {
            self.log(CAMERA, &transform(pose));
        }
        if let Some(((id, kind), world_from_camera)) = keyframe {
            let keyframe = Keyframe {
                kind,
                world_from_camera,
                submap: result.submap,
            };
            self.frame_of.insert(id, result.index.0);
            self.add_keyframe(result.index.0, keyframe);
        }
        let tracking = result.tracking.as_ref();
        self.plot(
            "tracking_ms",
            tracking.map(|t| 1e3 * t.duration.as_secs_f64()),
        );
        self.plot("uncertainty_mm", tracking.map(|t| 1e3 * t.uncertainty_m));
        self.plot("residual_mm", tracking.map(|t| 1e3 * t.residual_m));
        self.plot("inliers", tracking.map(|t| t.inliers as f64));
        self.plot("gaussians", Some(num_gaussians as f64));
        self.plot("steps", Some(steps as f64));
        if self.status != Some(result.status) {
            self.status = Some(result.status);
            let text = error.map_or(String::new(), |error| format!(": {error}"));
            let text = format!("frame {} is {}{text}", result.index.0, result.status);
            let level = match result.status {
                FrameStatus::Tracked => TextLogLevel::INFO,
                _ => TextLogLevel::WARN,
            };
            self.log("log", &TextLog::new(text).with_level(level));
        }
        if self.way_growth.is_due(self.frames.len()) {
            self.draw_way();
        }
        if self.graph_growth.is_due(self.keyframes.len()) {
            self.draw_graph();
        }
    }

    fn corrected(&mut self, poses: &[(KeyframeId, Se3)]) {
        self.now();
        for (id, pose) in poses {
            if let Some(frame) = self.frame_of.get(id).copied()
                && let Some(keyframe) = self.keyframes.get_mut(&frame)
                && keyframe.world_from_camera != *pose
            {
                keyframe.world_from_camera = *pose;
                self.put_keyframe(frame);
            }
        }
    }

    fn closed_loop(&mut self, from: KeyframeId, to: KeyframeId) {
        self.loops.push([from, to]);
        self.now();
        let text = format!("keyframe {} shows what keyframe {} shows", to.0, from.0);
        self.log("log", &TextLog::new(text).with_level(TextLogLevel::INFO));
        self.draw_graph();
    }

    fn refined(&mut self, _done: usize, _total: usize) {}

    fn map(&mut self, map: &Gaussians) {
        if self.map_growth.is_due(map.len()) {
            self.now();
            self.log("world/map", &splats(map));
        }
    }

    fn rendered(&mut self, render: Render) {
        self.at_frame(render.index.0);
        self.plot("psnr_db", Some(render.psnr_db));
        for (picture, jpeg) in render.pictures {
            let named = PICTURES.into_iter().find(|named| named.picture == picture);
            let path = named.map_or_else(input_path, picture_path);
            self.log(path, &EncodedImage::from_file_contents(jpeg));
        }
    }

    fn added(&mut self, addition: &Addition, jpeg: Vec<u8>) {
        self.at_frame(addition.frame.index.0);
        let named = PICTURES
            .into_iter()
            .find(|named| named.picture == Picture::Addition);
        if let Some(named) = named {
            self.log(picture_path(named), &EncodedImage::from_file_contents(jpeg));
        }
    }
}

/// Where a keyframe is.
fn keyframe_path(frame: usize, kind: KeyframeKind) -> String {
    format!("world/keyframes/{kind}/{frame}")
}

fn point(position: &Vector3<f64>) -> [f32; 3] {
    position.map(|x| x as f32).into()
}

fn transform(world_from_camera: &Se3) -> Transform3D {
    let [x, y, z, w]: [f64; 4] = world_from_camera.rotation.coords.into();
    Transform3D::from_translation_rotation(
        point(&world_from_camera.translation),
        Quaternion::from_xyzw([x, y, z, w].map(|q| q as f32)),
    )
}

fn pinhole(camera: &Camera, size_m: f32) -> Pinhole {
    let i = &camera.intrinsics;
    let [fx, fy, cx, cy] = [i.fx, i.fy, i.cx, i.cy].map(|x| x as f32);
    let size = [camera.width as f32, camera.height as f32];
    // Theirs are pixels' corners at integers.
    Pinhole::from_focal_length_and_resolution([fx, fy], size)
        .with_principal_point([cx + 0.5, cy + 0.5])
        .with_image_plane_distance(size_m)
}

fn lines(strips: impl IntoIterator<Item = Vec<Vector3<f64>>>, color: [u8; 3]) -> LineStrips3D {
    let strips = strips.into_iter();
    let strips = strips.map(|strip| strip.iter().map(point).collect::<Vec<_>>());
    LineStrips3D::new(strips).with_colors([color])
}

/// A map as Rerun has it: standard deviations, colours with opacities, rotations xyzw.
fn splats(map: &Gaussians) -> GaussianSplats3D {
    let all = 0..map.len();
    let byte = |value: f32| (255.0 * value).round() as u8;
    let color = |i| {
        let [r, g, b] = map.rgb(i).map(byte);
        Color::from_unmultiplied_rgba(r, g, b, byte(map.opacity(i)))
    };
    let rotation = |i| {
        let [w, x, y, z] = unit_quat(map, i);
        Quaternion::from_xyzw([x, y, z, w])
    };
    GaussianSplats3D::new(map.means.iter().copied())
        .with_scales(all.clone().map(|i| map.scales(i)))
        .with_quaternions(all.clone().map(rotation))
        .with_colors(all.map(color))
}
