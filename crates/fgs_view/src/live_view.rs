//! Looks on while a run works, and keeps what a live page shows.
//!
//! It must not hold the run up. It has a thread and a bounded queue of its own; without a browser it
//! only notes frames and keyframes. With one it asks for a map and a frame's images now and then, and then
//! rests for many times as long as it took to draw them.

use std::borrow::Cow;
use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use crossbeam_channel::RecvTimeoutError;
use fgs_data::Trajectory;
use fgs_export::up_direction;
use fgs_geom::{Camera, KeyframeId, RgbdFrame, Se3, View};
use fgs_slam::{Addition, FrameResult, Slam, SlamEvent, Subscription};
use fgs_splat::Gaussians;
use nalgebra::Vector3;
use rayon::ThreadPool;
use serde::Serialize;

use crate::live_state::{
    AdditionNote, FrameNote, KeyframeNote, LiveState, Phase, Picture, PoseNote, RenderNote,
};
use crate::page::{made, page};
use crate::pictures;
use crate::server::{Listener, Server};
use crate::site::half_extent;

/// Room for a second or two; then events are missed.
const QUEUE: usize = 256;
/// Drawing takes at most one part in so many of this thread's time.
const REST: u32 = 15;
/// Nobody needs news of the map more often.
const MIN_REST: Duration = Duration::from_millis(700);
/// How often to see whether somebody looks on.
const POLL: Duration = Duration::from_millis(100);
/// So many poses tell how the camera moves.
const POSES: usize = 3;
/// What to wait at the end for slow networks.
const FAREWELL: Duration = Duration::from_secs(5);

/// A live page, from before a run until it ends.
pub struct LiveView {
    state: Arc<LiveState>,
    server: Server,
    total: usize,
    thread: Option<JoinHandle<()>>,
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
        let watcher = Watcher {
            state: Arc::clone(&self.state),
            events: session.subscribe(QUEUE),
            threads: rayon::ThreadPoolBuilder::new()
                .num_threads(1)
                .thread_name(|_| "live".into())
                .build()
                .map_err(io::Error::other)?,
            start: Instant::now(),
            total: self.total,
            frames: 0,
            keyframes: BTreeMap::new(),
            newest: None,
            poses: VecDeque::new(),
            cameras_up: Vector3::zeros(),
            map: Arc::default(),
            up_of: 0,
            photographed: None,
        };
        let thread = thread::Builder::new().name("live view".into());
        self.thread = Some(thread.spawn(move || watcher.look_on())?);
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

/// The thread that looks on.
struct Watcher {
    state: Arc<LiveState>,
    events: Subscription,
    /// One: the run needs the others.
    threads: ThreadPool,
    start: Instant,
    total: usize,
    frames: usize,
    keyframes: BTreeMap<u32, Se3>,
    newest: Option<u32>,
    /// The last poses, with their times: how the camera moves.
    poses: VecDeque<(f64, Se3)>,
    /// Sum of the cameras' -y axes.
    cameras_up: Vector3<f64>,
    map: Arc<Gaussians>,
    /// How many gaussians the map had when it was last found out which way is up.
    up_of: usize,
    /// Images that have no render yet.
    photographed: Option<(Arc<RgbdFrame>, Se3)>,
}

impl Watcher {
    fn look_on(mut self) {
        let mut next = Instant::now();
        loop {
            match self.events.events().recv_timeout(POLL) {
                Ok(event) => {
                    let start = Instant::now();
                    let took_long = self.note(event);
                    if took_long {
                        next = next.max(Instant::now() + MIN_REST.max(REST * start.elapsed()));
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            if self.state.is_watched() && Instant::now() >= next {
                self.events.request_images();
                self.events.request_addition();
                self.events.request_snapshot();
                // Whatever comes of it sets the time anew.
                next = Instant::now() + MIN_REST;
            }
        }
    }

    /// Takes an event over; whether there was something to draw.
    fn note(&mut self, event: SlamEvent) -> bool {
        match event {
            SlamEvent::Frame {
                result,
                error,
                num_gaussians,
                steps,
            } => self.frame(&result, error, num_gaussians, steps),
            SlamEvent::Correction(poses) => self.correct(&poses),
            SlamEvent::Loop { from, to } => {
                self.state.change(|scene| scene.add_loop(from.0, to.0));
            }
            SlamEvent::Refined { done, steps } => self.state.change(|scene| {
                scene.set_phase(Phase {
                    name: "refining",
                    done,
                    total: steps,
                    ..Phase::default()
                });
            }),
            SlamEvent::Images(frame) => {
                let last = self.poses.back();
                let pose = last.filter(|(secs, _)| *secs == frame.timestamp_secs);
                self.photographed = pose.map(|(_, pose)| (frame, *pose));
            }
            SlamEvent::Snapshot(map) => {
                self.map = map;
                self.draw();
                return true;
            }
            SlamEvent::Addition(addition) => {
                self.addition(&addition);
                return true;
            }
            _ => {}
        }
        false
    }

    fn frame(
        &mut self,
        result: &FrameResult,
        error: Option<String>,
        gaussians: usize,
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
        if let Some((secs, pose)) = result.timestamp_secs.zip(result.world_from_camera) {
            self.poses.push_back((secs, pose));
            if self.poses.len() > POSES {
                self.poses.pop_front();
            }
            self.cameras_up -= pose.rotation * Vector3::y();
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
            gaussians,
            steps,
            error,
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

    fn correct(&mut self, poses: &[(KeyframeId, Se3)]) {
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

    /// Shows the map, and what it looks like where the last images were taken.
    fn draw(&mut self) {
        // A direction that is found once the map shows more of the room is a better one.
        if self.map.len() > self.up_of + self.up_of / 4 {
            self.up_of = self.map.len();
            let up = up_direction(&self.map, self.cameras_up);
            self.state.change(|scene| scene.set_up([up.x, up.y, up.z]));
        }
        self.state
            .change(|scene| scene.splats.update(&self.map, false));
        let Some((frame, world_from_camera)) = self.photographed.take() else {
            return;
        };
        let size = pictures::small(&frame.camera);
        let view = View {
            camera: size,
            world_from_camera,
        };
        let rendered = self.threads.install(|| pictures::render(&self.map, &view));
        let photograph = pictures::color(&self.synchronized(&frame).color, &size);
        let shown = pictures::rendered_color(&rendered);
        let depth_m = pictures::small_depth(&frame.depth_m, &size);
        let range = pictures::depth_range(&depth_m);
        let note = RenderNote {
            index: frame.index.0,
            psnr_db: pictures::psnr_db(&frame, &photograph, &shown, &size),
        };
        let depth = pictures::depth_colors(&depth_m, range);
        let rendered_depth = pictures::rendered_depth(&rendered);
        let rendered_depth = pictures::depth_colors(&rendered_depth, range);
        let all = [
            (Picture::Input, photograph),
            (Picture::Render, shown),
            (Picture::Depth, depth),
            (Picture::RenderedDepth, rendered_depth),
        ]
        .map(|(picture, pixels)| (picture, pictures::jpeg(&pixels)));
        self.state.change(|scene| {
            scene.add_render(note);
            for (picture, jpeg) in all {
                scene.put_picture(picture, jpeg);
            }
        });
    }

    /// A frame as the camera would have taken it with all rows at once, if it is known how it moved.
    fn synchronized<'a>(&self, frame: &'a RgbdFrame) -> Cow<'a, RgbdFrame> {
        let way = Trajectory::new(self.poses.iter().copied());
        way.map_or(Cow::Borrowed(frame), |way| way.synchronized(frame))
    }

    fn addition(&self, addition: &Addition) {
        let size = pictures::small(&addition.frame.camera);
        let (detail, missing) = (&addition.detail, &addition.missing);
        let picture = pictures::addition(&addition.frame.color, detail, missing, &size);
        let note = AdditionNote {
            index: addition.frame.index.0,
            seeds: addition.seeds,
            detail: pictures::share(detail),
            missing: pictures::share(missing),
        };
        let jpeg = pictures::jpeg(&picture);
        self.state.change(|scene| {
            scene.add_addition(note);
            scene.put_picture(Picture::Addition, jpeg);
        });
    }
}
