//! Keeps what a live page shows of a run at work.

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use fgs_geom::{Camera, KeyframeId, Se3};
use fgs_slam::{Addition, FrameResult, Slam};
use fgs_splat::Gaussians;
use nalgebra::Vector3;
use serde::Serialize;

use crate::live_state::{
    AdditionNote, FrameNote, KeyframeNote, LiveState, Phase, PoseNote, RenderNote,
};
use crate::page::{made, page};
use crate::pictures;
use crate::server::{Listener, Server};
use crate::site::half_extent;
use crate::watcher::{Audience, Picture, Render, watch};

/// What to wait at the end for slow networks.
const FAREWELL: Duration = Duration::from_secs(5);

/// A live page, from before a run until it ends.
pub struct LiveView {
    state: Arc<LiveState>,
    server: Server,
    total: usize,
    thread: Option<JoinHandle<Viewers>>,
}

/// What the page knows from the start: `scene.json`.
#[derive(Serialize)]
struct Start<'a> {
    live: bool,
    /// A random number: a page that loses its server and finds another's run is loaded anew.
    run: u32,
    title: &'a str,
    half_extent: [f64; 2],
}

impl LiveView {
    /// Serves a page of a run called `title` over `frames` frames of a camera, 0 if nobody knows how many. Its button to stop sets `stop`.
    ///
    /// # Errors
    /// If no thread starts.
    pub fn start(
        listener: Listener,
        title: &str,
        camera: &Camera,
        frames: usize,
        stop: Arc<AtomicBool>,
    ) -> io::Result<Self> {
        let state = Arc::new(LiveState::new(stop));
        let start = serde_json::to_vec(&Start {
            live: true,
            run: rand::random(),
            title,
            half_extent: half_extent(camera),
        })?;
        let mut files = page();
        files.insert("scene.json".into(), made("application/json", start));
        let server = Server::start(listener, files, Some(Arc::clone(&state)))?;
        Ok(Self {
            state,
            server,
            total: frames,
            thread: None,
        })
    }

    /// The server, which says where the page is.
    pub fn server(&self) -> &Server {
        &self.server
    }

    /// Looks on from now on, until the session ends.
    ///
    /// # Errors
    /// If no thread starts.
    pub fn watch(&mut self, session: &Slam) -> io::Result<()> {
        let viewers = Viewers {
            state: Arc::clone(&self.state),
            start: Instant::now(),
            total: self.total,
            frames: 0,
            keyframes: BTreeMap::new(),
            newest: None,
        };
        self.thread = Some(watch(session, viewers)?);
        Ok(())
    }

    /// Says what the run does now.
    pub fn phase(&self, name: &'static str, done: usize, total: usize) {
        self.state.change(|scene| {
            scene.set_phase(Phase {
                name,
                done,
                total,
                message: String::new(),
            });
        });
    }

    /// The run is over: shows its map, and a message. Waits a moment for whoever looks on to hear of it.
    pub fn end(mut self, map: Option<&Gaussians>, message: String) {
        if let Some(thread) = self.thread.take() {
            // Its session has ended. A panic there was its own.
            let _ = thread.join();
        }
        self.state.end(map, message);
        self.state.wait_for_clients(FAREWELL);
    }
}

/// Those who look on in browsers.
struct Viewers {
    state: Arc<LiveState>,
    start: Instant,
    total: usize,
    frames: usize,
    keyframes: BTreeMap<u32, Se3>,
    newest: Option<u32>,
}

impl Audience for Viewers {
    fn is_watching(&self) -> bool {
        self.state.is_watched()
    }

    fn frame(
        &mut self,
        result: &FrameResult,
        error: Option<&str>,
        num_gaussians: usize,
        steps: usize,
    ) {
        self.frames += 1;
        if let (Some((id, kind)), Some(pose)) = (result.keyframe, result.world_from_camera) {
            self.keyframes.insert(id.0, pose);
            self.newest = Some(id.0);
            let note = KeyframeNote {
                id: id.0,
                index: result.index.0,
                kind,
                pose: PoseNote::from(&pose),
            };
            self.state.change(|scene| scene.put_keyframe(note));
        }
        let anchor = self
            .newest
            .and_then(|id| Some((id, self.keyframes.get(&id)?)));
        let position = anchor
            .zip(result.world_from_camera)
            .map(|((id, keyframe), pose)| {
                let position = keyframe.inverse().transform(&pose.translation);
                (id, [position.x, position.y, position.z].map(|x| x as f32))
            });
        let tracking = result.tracking.as_ref();
        let note = FrameNote {
            index: result.index.0,
            secs: self.start.elapsed().as_secs_f64(),
            status: result.status,
            anchor: position.map(|(id, _)| id),
            position: position.map(|(_, position)| position),
            keyframe: result.keyframe.map(|(_, kind)| kind),
            tracking_ms: tracking.map(|tracking| 1e3 * tracking.duration.as_secs_f64()),
            residual_mm: tracking.map(|tracking| 1e3 * tracking.residual_m),
            points: tracking.map(|tracking| tracking.points),
            inliers: tracking.map(|tracking| tracking.inliers),
            gaussians: num_gaussians,
            steps,
            error: error.map(str::to_owned),
        };
        let pose = result.world_from_camera.as_ref().map(PoseNote::from);
        let phase = Phase {
            name: "tracking",
            done: self.frames,
            total: self.total,
            ..Phase::default()
        };
        self.state.change(|scene| {
            scene.add_frame(note, pose);
            scene.set_phase(phase);
        });
    }

    fn corrected(&mut self, poses: &[(KeyframeId, Se3)]) {
        for (id, pose) in poses {
            self.keyframes.insert(id.0, *pose);
        }
        self.state.change(|scene| {
            for (id, pose) in poses {
                if let Some(note) = scene.keyframe_mut(id.0) {
                    note.pose = PoseNote::from(pose);
                }
            }
        });
    }

    fn closed_loop(&mut self, from: KeyframeId, to: KeyframeId) {
        self.state.change(|scene| scene.add_loop(from.0, to.0));
    }

    fn refined(&mut self, done: usize, total: usize) {
        self.state.change(|scene| {
            scene.set_phase(Phase {
                name: "refining",
                done,
                total,
                ..Phase::default()
            });
        });
    }

    fn found_up(&mut self, up: Vector3<f64>) {
        self.state.change(|scene| scene.set_up(up.into()));
    }

    fn map(&mut self, map: &Gaussians) {
        self.state.change(|scene| scene.splats.update(map, false));
    }

    fn rendered(&mut self, render: Render) {
        self.state.change(|scene| {
            scene.add_render(RenderNote {
                index: render.index.0,
                psnr_db: render.psnr_db,
            });
            for (picture, jpeg) in render.pictures {
                scene.put_picture(picture, jpeg);
            }
        });
    }

    fn added(&mut self, addition: &Addition, jpeg: Vec<u8>) {
        let note = AdditionNote {
            index: addition.frame.index.0,
            seeds: addition.seeds,
            detail: pictures::share(&addition.detail),
            missing: pictures::share(&addition.missing),
        };
        self.state.change(|scene| {
            scene.add_addition(note);
            scene.put_picture(Picture::Addition, jpeg);
        });
    }
}
