//! Looks on while a run works, and tells an [`Audience`] what there is to see.
//!
//! It must not hold the run up. It has a thread and a bounded queue of its own; without an audience it
//! only passes on frames and keyframes. With one it asks for a map and a frame's images now and then, and
//! then rests for many times as long as it took to draw them.

use std::borrow::Cow;
use std::collections::VecDeque;
use std::io;
use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use crossbeam_channel::RecvTimeoutError;
use fgs_data::Trajectory;
use fgs_export::up_direction;
use fgs_geom::{Camera, FrameIndex, KeyframeId, RgbdFrame, Se3, View};
use fgs_slam::{Addition, FrameResult, Slam, SlamEvent, Subscription};
use fgs_splat::Gaussians;
use nalgebra::Vector3;
use rayon::ThreadPool;

use crate::pictures;

/// Room for a second or two; then events are missed.
const QUEUE: usize = 256;
/// Drawing takes at most one part in so many of this thread's time.
const REST: u32 = 25;
/// Nobody needs news of the map more often.
const MIN_REST: Duration = Duration::from_millis(700);
/// How often to see whether somebody looks on.
const POLL: Duration = Duration::from_millis(100);
/// So many poses tell how the camera moves.
const POSES: usize = 3;

/// The pictures of a run at work; their numbers are part of the live page's stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Picture {
    /// What the camera took.
    Input = 0,
    /// What the map looks like there.
    Render = 1,
    /// Measured depth, as colours.
    Depth = 2,
    /// The render's depth, in the same colours.
    RenderedDepth = 3,
    /// A keyframe, dark, with where it has detail and where the map lacked gaussians.
    Addition = 4,
}

/// Those who are told what a run does. Every call comes from the thread that looks on.
pub trait Audience: Send + 'static {
    /// Whether the map and pictures are wanted now.
    fn is_watching(&self) -> bool;

    /// A frame was tracked, weak, lost, dropped or found damaged; `error` says why it is damaged.
    fn frame(
        &mut self,
        result: &FrameResult,
        error: Option<&str>,
        num_gaussians: usize,
        steps: usize,
    );

    /// Keyframes have new poses `world_from_camera`.
    fn corrected(&mut self, poses: &[(KeyframeId, Se3)]);

    /// The camera is back: keyframe `to` shows what the older `from` shows.
    fn closed_loop(&mut self, from: KeyframeId, to: KeyframeId);

    /// The map was refined by one more step, after the last frame.
    fn refined(&mut self, done: usize, total: usize);

    /// Which way is up, of length 1, in the map's coordinates.
    fn found_up(&mut self, _up: Vector3<f64>) {}

    /// The map as it was a moment ago.
    fn map(&mut self, map: &Gaussians);

    /// A frame and what the map looks like there.
    fn rendered(&mut self, render: Render);

    /// What a keyframe gives to the map.
    fn added(&mut self, addition: &Addition, jpeg: Vec<u8>);
}

/// A frame and what the map looks like there, small.
pub struct Render {
    /// Which frame.
    pub index: FrameIndex,
    /// Of the small picture against the small photograph, over all pixels that a camera saw.
    pub psnr_db: f64,
    /// JPEG files.
    pub pictures: [(Picture, Vec<u8>); 4],
}

/// The camera of the pictures of a run whose camera is `camera`.
pub fn picture_camera(camera: &Camera) -> Camera {
    pictures::small(camera)
}

/// Looks on from now on, until the session ends; then the thread returns the audience.
///
/// # Errors
/// If no thread starts.
pub fn watch<A: Audience>(session: &Slam, audience: A) -> io::Result<JoinHandle<A>> {
    let watcher = Watcher {
        audience,
        events: session.subscribe(QUEUE),
        threads: rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .thread_name(|_| "watcher".into())
            .build()
            .map_err(io::Error::other)?,
        poses: VecDeque::new(),
        cameras_up: Vector3::zeros(),
        map: Arc::default(),
        up_of: 0,
        photographed: None,
    };
    let thread = thread::Builder::new().name("watcher".into());
    thread.spawn(move || watcher.look_on())
}

/// The thread that looks on.
struct Watcher<A> {
    audience: A,
    events: Subscription,
    /// One: the run needs the others.
    threads: ThreadPool,
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

impl<A: Audience> Watcher<A> {
    fn look_on(mut self) -> A {
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
                Err(RecvTimeoutError::Disconnected) => return self.audience,
            }
            if self.audience.is_watching() && Instant::now() >= next {
                self.events.request_images();
                self.events.request_addition();
                self.events.request_snapshot();
                // Whatever comes of it sets the time anew.
                next = Instant::now() + MIN_REST;
            }
        }
    }

    /// Passes an event on; whether there was something to draw.
    fn note(&mut self, event: SlamEvent) -> bool {
        match event {
            SlamEvent::Frame {
                result,
                error,
                num_gaussians,
                steps,
            } => {
                if let Some((secs, pose)) = result.timestamp_secs.zip(result.world_from_camera) {
                    self.poses.push_back((secs, pose));
                    if self.poses.len() > POSES {
                        self.poses.pop_front();
                    }
                    self.cameras_up -= pose.rotation * Vector3::y();
                }
                self.audience
                    .frame(&result, error.as_deref(), num_gaussians, steps);
            }
            SlamEvent::Correction(poses) => self.audience.corrected(&poses),
            SlamEvent::Loop { from, to } => self.audience.closed_loop(from, to),
            SlamEvent::Refined { done, steps } => self.audience.refined(done, steps),
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
                let size = pictures::small(&addition.frame.camera);
                let (detail, missing) = (&addition.detail, &addition.missing);
                let picture = pictures::addition(&addition.frame.color, detail, missing, &size);
                self.audience.added(&addition, pictures::jpeg(&picture));
                return true;
            }
            _ => {}
        }
        false
    }

    /// Shows the map, and what it looks like where the last images were taken.
    fn draw(&mut self) {
        // A direction that is found once the map shows more of the room is a better one.
        if self.map.len() > self.up_of + self.up_of / 4 {
            self.up_of = self.map.len();
            let up = up_direction(&self.map, self.cameras_up);
            self.audience.found_up(up);
        }
        self.audience.map(&self.map);
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
        let psnr_db = pictures::psnr_db(&frame, &photograph, &shown, &size);
        let depth = pictures::depth_colors(&depth_m, range);
        let rendered_depth = pictures::rendered_depth(&rendered);
        let rendered_depth = pictures::depth_colors(&rendered_depth, range);
        self.audience.rendered(Render {
            index: frame.index,
            psnr_db,
            pictures: [
                (Picture::Input, photograph),
                (Picture::Render, shown),
                (Picture::Depth, depth),
                (Picture::RenderedDepth, rendered_depth),
            ]
            .map(|(picture, pixels)| (picture, pictures::jpeg(&pixels))),
        });
    }

    /// A frame as the camera would have taken it with all rows at once, if it is known how it moved.
    fn synchronized<'a>(&self, frame: &'a RgbdFrame) -> Cow<'a, RgbdFrame> {
        let way = Trajectory::new(self.poses.iter().copied());
        way.map_or(Cow::Borrowed(frame), |way| way.synchronized(frame))
    }
}
