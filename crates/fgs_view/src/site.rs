//! A finished map as pages that any web server can serve: paths are relative, nothing comes from elsewhere.

use std::io;
use std::ops::ControlFlow;

use fgs_export::write_splat;
use fgs_files::StagedFolder;
use fgs_geom::{Camera, RgbdFrame, Se3, View};
use fgs_slam::KeyframeKind;
use fgs_splat::Gaussians;
use nalgebra::Vector3;
use serde::Serialize;

use crate::access::Address;
use crate::live_state::PoseNote;
use crate::page::{Files, made, page};
use crate::pictures;
use crate::response::unzipped;
use crate::server::{Listener, Server};

/// More would be a long wait and a long list.
const MAX_PICTURES: usize = 48;
/// Points of the trajectory; more are not seen.
const MAX_POINTS: usize = 20_000;

const JSON: &str = "application/json";
const JPEG: &str = "image/jpeg";
const SPLATS: &str = "application/octet-stream";

/// What a finished run is called and what it came to.
#[derive(Clone, Debug, Default)]
pub struct Summary {
    /// Its name.
    pub title: String,
    /// What to say about it: labels and values.
    pub numbers: Vec<(String, String)>,
}

/// A keyframe of a finished run.
#[derive(Clone, Copy, Debug)]
pub struct SiteKeyframe {
    /// Position of its frame in the recording.
    pub index: usize,
    /// What it was for, if known.
    pub kind: Option<KeyframeKind>,
    /// Its pose.
    pub world_from_camera: Se3,
}

/// The camera of the keyframes' pictures, and where their photographs come from.
pub struct KeyframePictures<'a> {
    /// The camera.
    pub camera: Camera,
    /// The frame, as it was taken, of the keyframe at a place in the list, if it can be read.
    pub photograph: &'a mut dyn FnMut(usize) -> Option<RgbdFrame>,
    /// Called after each picture; may stop the work.
    pub on_picture: &'a mut dyn FnMut() -> ControlFlow<()>,
}

/// Pages that show a map.
pub struct Site {
    files: Files,
}

/// `scene.json`.
#[derive(Serialize)]
struct Scene<'a> {
    live: bool,
    title: &'a str,
    numbers: &'a [(String, String)],
    gaussians: usize,
    /// Upward in the map's coordinates.
    up: [f64; 3],
    /// Half the width and half the height of an image at a distance of one.
    half_extent: Option<[f64; 2]>,
    path: Vec<[f32; 3]>,
    keyframes: Vec<SceneKeyframe>,
}

#[derive(Serialize)]
struct SceneKeyframe {
    index: usize,
    kind: Option<KeyframeKind>,
    #[serde(flatten)]
    pose: PoseNote,
    render: Option<String>,
    input: Option<String>,
}

impl Site {
    /// Of a map in which `up` is upward, with the poses of its camera in order and its keyframes; some of these, evenly spread, have
    /// pictures, if there is a camera.
    ///
    /// # Errors
    /// [`io::ErrorKind::Interrupted`] if `on_picture` stopped the work.
    pub fn new(
        summary: &Summary,
        map: &Gaussians,
        up: Vector3<f64>,
        poses: &[Se3],
        keyframes: &[SiteKeyframe],
        mut pictures: Option<KeyframePictures<'_>>,
    ) -> io::Result<Self> {
        let mut files = page();
        let stride = keyframes.len().div_ceil(MAX_PICTURES).max(1);
        let mut shown = Vec::new();
        for (i, keyframe) in keyframes.iter().enumerate() {
            let mut scene = SceneKeyframe {
                index: keyframe.index,
                kind: keyframe.kind,
                pose: PoseNote::from(&keyframe.world_from_camera),
                render: None,
                input: None,
            };
            if let Some(pictures) = &mut pictures
                && i % stride == 0
            {
                add_pictures(&mut files, &mut scene, map, (i, keyframe), pictures);
                if (pictures.on_picture)().is_break() {
                    return Err(io::ErrorKind::Interrupted.into());
                }
            }
            shown.push(scene);
        }
        let stride = poses.len().div_ceil(MAX_POINTS).max(1);
        let path = poses.iter().step_by(stride);
        let scene = Scene {
            live: false,
            title: &summary.title,
            numbers: &summary.numbers,
            gaussians: map.len(),
            up: up.into(),
            half_extent: pictures
                .as_ref()
                .map(|pictures| half_extent(&pictures.camera)),
            path: path
                .map(|pose| pose.translation.map(|x| x as f32).into())
                .collect(),
            keyframes: shown,
        };
        files.insert("scene.json".into(), made(JSON, serde_json::to_vec(&scene)?));
        let mut splats = Vec::new();
        write_splat(&mut splats, map)?;
        files.insert("map.splat".into(), made(SPLATS, splats));
        Ok(Self { files })
    }

    /// How many pictures [`new`](Self::new) makes of so many keyframes.
    pub fn pictures(keyframes: usize) -> usize {
        keyframes.div_ceil(keyframes.div_ceil(MAX_PICTURES).max(1))
    }

    /// Serves the pages.
    ///
    /// # Errors
    /// If the address cannot be listened at.
    pub fn serve(self, address: &Address) -> io::Result<Server> {
        Server::start(Listener::bind(address)?, self.files, None)
    }

    /// Writes the pages.
    ///
    /// # Errors
    /// If writing fails.
    pub fn write(&self, folder: &StagedFolder<'_>) -> io::Result<()> {
        for (name, file) in &self.files {
            let bytes = unzipped(file)?;
            folder.write(name, |out| io::Write::write_all(out, &bytes))?;
        }
        Ok(())
    }
}

/// Half the width and half the height of an image at a distance of one, for a frustum.
pub(crate) fn half_extent(camera: &Camera) -> [f64; 2] {
    let half = |pixels: usize, focal: f64| 0.5 * pixels as f64 / focal;
    [
        half(camera.width, camera.intrinsics.fx),
        half(camera.height, camera.intrinsics.fy),
    ]
}

fn add_pictures(
    files: &mut Files,
    scene: &mut SceneKeyframe,
    map: &Gaussians,
    (place, keyframe): (usize, &SiteKeyframe),
    pictures: &mut KeyframePictures<'_>,
) {
    let size = pictures::small(&pictures.camera);
    let view = View {
        camera: size,
        world_from_camera: keyframe.world_from_camera,
    };
    let mut add = |name: String, picture| {
        files.insert(name.clone(), made(JPEG, pictures::jpeg(&picture)));
        Some(name)
    };
    let render = pictures::rendered_color(&pictures::render(map, &view));
    scene.render = add(format!("pictures/{place:06}-render.jpg"), render);
    if let Some(frame) = (pictures.photograph)(place) {
        let photograph = pictures::color(&frame.color, &size);
        scene.input = add(format!("pictures/{place:06}-input.jpg"), photograph);
    }
}
