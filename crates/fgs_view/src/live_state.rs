//! What a live page shows: the one place where the thread that looks on leaves what is new, and from which each
//! client takes what it has not seen. Nobody waits for a client: who is slow sees less.

use std::collections::{BTreeMap, VecDeque};
use std::io::{self, Write};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use fgs_geom::Se3;
use fgs_slam::{FrameStatus, KeyframeKind};
use fgs_splat::Gaussians;
use serde::Serialize;

use crate::splat_chunks::{Patch, Sent, SplatChunks};
use crate::watcher::Picture;

/// So many frames are kept for those who come later: their part of the trajectory and of the plots.
const MAX_FRAMES: usize = 20_000;
/// A client is told what is new at most this often.
const PERIOD: Duration = Duration::from_millis(150);
/// Somebody who hears nothing for so long hears that.
const SILENCE: Duration = Duration::from_secs(2);
/// Bytes of splats sent to a client in a second; a wireless network carries as much.
const MAX_SPLAT_BYTES_PER_SEC: usize = 3 << 20;
const MAX_STREAMS: usize = 8;

/// A frame, as the page knows it.
#[derive(Clone, Debug, Serialize)]
pub struct FrameNote {
    pub index: usize,
    /// Seconds since the run began.
    pub secs: f64,
    pub status: FrameStatus,
    /// The keyframe to which the position is given.
    pub anchor: Option<u32>,
    /// Position of the camera in that keyframe's axes, metres.
    pub position: Option<[f32; 3]>,
    pub keyframe: Option<KeyframeKind>,
    pub tracking_ms: Option<f64>,
    pub residual_mm: Option<f64>,
    pub points: Option<usize>,
    pub inliers: Option<usize>,
    pub gaussians: usize,
    pub steps: usize,
    pub error: Option<String>,
}

/// A pose `world_from_camera`.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct PoseNote {
    /// wxyz.
    quat: [f64; 4],
    /// Metres.
    position: [f64; 3],
}

impl From<&Se3> for PoseNote {
    fn from(pose: &Se3) -> Self {
        let [x, y, z, w] = pose.rotation.coords.into();
        Self {
            quat: [w, x, y, z],
            position: pose.translation.into(),
        }
    }
}

/// A keyframe, as the page knows it.
#[derive(Clone, Debug, Serialize)]
pub struct KeyframeNote {
    pub id: u32,
    pub index: usize,
    pub kind: KeyframeKind,
    #[serde(flatten)]
    pub pose: PoseNote,
}

/// A frame that was rendered.
#[derive(Clone, Debug, Serialize)]
pub struct RenderNote {
    pub index: usize,
    /// Of the small picture against the small photograph, over all pixels that a camera saw.
    pub psnr_db: f64,
}

/// A keyframe's gift to the map.
#[derive(Clone, Debug, Serialize)]
pub struct AdditionNote {
    pub index: usize,
    pub seeds: usize,
    /// Shares of the image.
    pub detail: f64,
    pub missing: f64,
}

/// What the page shows in a line.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Phase {
    /// `tracking`, `refining`, `scoring` or `ended`.
    pub name: &'static str,
    pub done: usize,
    pub total: usize,
    /// What there is to say at the end.
    pub message: String,
}

/// Everything that a client may be told.
#[derive(Default)]
pub struct Scene {
    frames: VecDeque<FrameNote>,
    current: Option<PoseNote>,
    /// How many frames were forgotten.
    forgotten: usize,
    keyframes: BTreeMap<u32, KeyframeNote>,
    loops: Vec<[u32; 2]>,
    /// Counts the changes of keyframes and loops.
    graph_version: u64,
    renders: Vec<RenderNote>,
    additions: Vec<AdditionNote>,
    /// Once it is known.
    up: Option<[f64; 3]>,
    phase: Phase,
    /// Counts the changes of the two above.
    phase_version: u64,
    pictures: BTreeMap<Picture, (u64, Arc<[u8]>)>,
    pub splats: SplatChunks,
    is_over: bool,
}

impl Scene {
    pub fn add_frame(&mut self, note: FrameNote, pose: Option<PoseNote>) {
        self.current = pose.or(self.current);
        self.frames.push_back(note);
        if self.frames.len() > MAX_FRAMES {
            self.frames.pop_front();
            self.forgotten += 1;
        }
    }

    pub fn put_keyframe(&mut self, note: KeyframeNote) {
        self.keyframes.insert(note.id, note);
        self.graph_version += 1;
    }

    pub fn keyframe_mut(&mut self, id: u32) -> Option<&mut KeyframeNote> {
        self.graph_version += 1;
        self.keyframes.get_mut(&id)
    }

    pub fn add_loop(&mut self, from: u32, to: u32) {
        self.loops.push([from, to]);
        self.graph_version += 1;
    }

    pub fn add_render(&mut self, note: RenderNote) {
        self.renders.push(note);
    }

    pub fn add_addition(&mut self, note: AdditionNote) {
        self.additions.push(note);
    }

    pub fn put_picture(&mut self, picture: Picture, jpeg: Vec<u8>) {
        let version = self
            .pictures
            .get(&picture)
            .map_or(0, |(version, _)| *version);
        self.pictures.insert(picture, (version + 1, jpeg.into()));
    }

    pub fn set_up(&mut self, up: [f64; 3]) {
        self.phase_version += u64::from(self.up != Some(up));
        self.up = Some(up);
    }

    pub fn set_phase(&mut self, phase: Phase) {
        self.phase_version += u64::from(self.phase != phase);
        self.phase = phase;
    }
}

/// What is new to a client, as JSON.
#[derive(Serialize)]
struct News<'a> {
    frames: Vec<&'a FrameNote>,
    /// Of the last frame that has one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pose: Option<PoseNote>,
    #[serde(skip_serializing_if = "Option::is_none")]
    keyframes: Option<Vec<&'a KeyframeNote>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    loops: Option<&'a [[u32; 2]]>,
    renders: &'a [RenderNote],
    additions: &'a [AdditionNote],
    #[serde(skip_serializing_if = "Option::is_none")]
    up: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    phase: Option<&'a Phase>,
}

/// What a client has been told.
#[derive(Default)]
struct Cursor {
    frames: usize,
    graph_version: u64,
    renders: usize,
    additions: usize,
    phase_version: u64,
    pictures: BTreeMap<Picture, u64>,
    sent: Sent,
}

/// What is to be sent to a client now.
struct Batch {
    json: Option<Vec<u8>>,
    pictures: Vec<(Picture, Arc<[u8]>)>,
    patches: Vec<Patch>,
    /// Nothing will follow.
    is_last: bool,
}

impl Cursor {
    fn advance(&mut self, scene: &Scene, max_splat_bytes: usize) -> Batch {
        let json = self.news(scene);
        let mut pictures = Vec::new();
        for (picture, (version, jpeg)) in &scene.pictures {
            if self.pictures.insert(*picture, *version) != Some(*version) {
                pictures.push((*picture, Arc::clone(jpeg)));
            }
        }
        let patches = scene.splats.patches(&mut self.sent, max_splat_bytes);
        Batch {
            json,
            pictures,
            patches,
            is_last: scene.is_over && scene.splats.are_sent(&self.sent),
        }
    }

    fn news(&mut self, scene: &Scene) -> Option<Vec<u8>> {
        let skipped = self.frames.saturating_sub(scene.forgotten);
        let has_graph = self.graph_version < scene.graph_version;
        let has_phase = self.phase_version < scene.phase_version;
        let news = News {
            frames: scene.frames.iter().skip(skipped).collect(),
            pose: scene.current,
            keyframes: has_graph.then(|| scene.keyframes.values().collect()),
            loops: has_graph.then_some(&scene.loops),
            renders: &scene.renders[self.renders..],
            additions: &scene.additions[self.additions..],
            up: scene.up.filter(|_| has_phase),
            phase: has_phase.then_some(&scene.phase),
        };
        let is_new = has_graph
            || has_phase
            || !(news.frames.is_empty() && news.renders.is_empty() && news.additions.is_empty());
        self.frames = scene.forgotten + scene.frames.len();
        self.graph_version = scene.graph_version;
        self.renders = scene.renders.len();
        self.additions = scene.additions.len();
        self.phase_version = scene.phase_version;
        // Plain structures without keys that could fail.
        is_new.then(|| serde_json::to_vec(&news).unwrap_or_default())
    }
}

/// A run at work, between the one thread that looks on and those that tell clients.
pub struct LiveState {
    scene: Mutex<Scene>,
    streams: AtomicUsize,
    is_closed: AtomicBool,
    stop: Arc<AtomicBool>,
}

const NEWS: u8 = 1;
const SPLATS: u8 = 2;
const PICTURE: u8 = 3;
const NOTHING: u8 = 4;
const END: u8 = 5;

impl LiveState {
    /// Of a run that ends when `stop` is set.
    pub fn new(stop: Arc<AtomicBool>) -> Self {
        Self {
            scene: Mutex::default(),
            streams: AtomicUsize::new(0),
            is_closed: AtomicBool::new(false),
            stop,
        }
    }

    /// Whether anybody looks on.
    pub fn is_watched(&self) -> bool {
        self.streams.load(Ordering::Relaxed) > 0
    }

    /// Asks the run to end.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Changes what is shown.
    pub fn change(&self, change: impl FnOnce(&mut Scene)) {
        change(&mut self.lock());
    }

    /// The run is over: clients are told what is left, and then that.
    pub fn end(&self, map: Option<&Gaussians>, message: String) {
        self.change(|scene| {
            if let Some(map) = map {
                scene.splats.update(map, true);
            }
            scene.set_phase(Phase {
                name: "ended",
                message,
                ..Phase::default()
            });
            scene.is_over = true;
        });
    }

    /// Waits until every client was told the end, but not for long.
    pub fn wait_for_clients(&self, patience: Duration) {
        let start = Instant::now();
        while self.is_watched() && start.elapsed() < patience {
            thread::sleep(Duration::from_millis(20));
        }
    }

    /// Nothing more is told.
    pub fn close(&self) {
        self.is_closed.store(true, Ordering::Relaxed);
    }

    /// Tells a client what is new until the run is over, or it has gone: messages of a `u32` length, a byte
    /// that says what it is, and the content.
    pub fn stream(&self, out: &mut impl Write) -> io::Result<()> {
        let _viewer = Viewer::new(&self.streams);
        if self.streams.load(Ordering::Relaxed) > MAX_STREAMS {
            return Ok(());
        }
        let mut cursor = Cursor::default();
        let mut last = Instant::now();
        // Whoever comes is told at once what there is.
        let mut budget = PERIOD;
        while !self.is_closed.load(Ordering::Relaxed) {
            let start = Instant::now();
            let max_bytes = MAX_SPLAT_BYTES_PER_SEC as f64 * budget.as_secs_f64();
            let batch = cursor.advance(&self.lock(), max_bytes as usize);
            let mut is_silent = true;
            if let Some(json) = &batch.json {
                write_message(out, NEWS, &[json])?;
                is_silent = false;
            }
            for (picture, jpeg) in &batch.pictures {
                write_message(out, PICTURE, &[&[*picture as u8], jpeg])?;
                is_silent = false;
            }
            for patch in &batch.patches {
                write_message(out, SPLATS, &[&patch.header(), patch.records()])?;
                is_silent = false;
            }
            if batch.is_last {
                return write_message(out, END, &[]);
            }
            if !is_silent {
                last = Instant::now();
            } else if last.elapsed() > SILENCE {
                // That somebody has gone shows only on writing.
                write_message(out, NOTHING, &[])?;
                last = Instant::now();
            }
            out.flush()?;
            thread::sleep(PERIOD.saturating_sub(start.elapsed()));
            budget = start.elapsed().min(Duration::from_secs(1));
        }
        Ok(())
    }

    /// The scene is whole at every moment that its lock is free.
    fn lock(&self) -> MutexGuard<'_, Scene> {
        self.scene.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Counts as one who looks on as long as it lives.
struct Viewer<'a>(&'a AtomicUsize);

impl<'a> Viewer<'a> {
    fn new(count: &'a AtomicUsize) -> Self {
        count.fetch_add(1, Ordering::Relaxed);
        Self(count)
    }
}

impl Drop for Viewer<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

fn write_message(out: &mut impl Write, kind: u8, parts: &[&[u8]]) -> io::Result<()> {
    let length: usize = parts.iter().map(|part| part.len()).sum();
    let length = u32::try_from(length).map_err(io::Error::other)?;
    let mut head = [0; 5];
    head[..4].copy_from_slice(&length.to_le_bytes());
    head[4] = kind;
    out.write_all(&head)?;
    parts.iter().try_for_each(|part| out.write_all(part))
}
