//! A sequence of RGB-D frames: a room, a camera path, a camera and a sensor model.

use std::sync::Arc;

use fgs_geom::{Camera, CameraError, FrameIndex, Intrinsics, RgbdFrame, Se3, View};

use crate::path::{CameraPath, FRAMES_PER_LOOP};
use crate::render::{Picture, render, render_moving};
use crate::room::Room;
use crate::round::Round;
use crate::sensor::SensorModel;
use crate::walk::Walk;

/// Frame rate of every sequence, Hz.
pub const FRAMES_PER_SECOND: f64 = 30.0;

/// Poses averaged over an exposure: enough to keep them at most a pixel apart at a normal pace, and odd,
/// so that one is in the middle.
pub(crate) const EXPOSED_MOMENTS: usize = 5;

/// A Kinect's camera: 640x480 pixels with its nominal intrinsics.
pub const KINECT: Camera = Camera {
    width: 640,
    height: 480,
    intrinsics: Intrinsics {
        fx: 525.0,
        fy: 525.0,
        cx: 319.5,
        cy: 239.5,
    },
};

/// A camera of any resolution with [`KINECT`]'s horizontal field of view.
///
/// # Errors
/// If a side is 0 or above 65536 pixels, or the image is far taller than wide.
pub fn kinect_camera(width: usize, height: usize) -> Result<Camera, CameraError> {
    let focal = KINECT.intrinsics.fx * width as f64 / KINECT.width as f64;
    let intrinsics = Intrinsics {
        fx: focal,
        fy: focal,
        cx: 0.5 * (width as f64 - 1.0),
        cy: 0.5 * (height as f64 - 1.0),
    };
    Camera::new(width, height, intrinsics)
}

/// The camera path.
enum Way {
    Loop(CameraPath),
    Walk(Walk),
    Round(Round),
}

/// A sequence of any number of frames, rendered on demand.
#[derive(Clone)]
pub struct Sequence {
    seed: u64,
    len: usize,
    room: Arc<Room>,
    way: Arc<Way>,
    camera: Camera,
    sensor: SensorModel,
}

impl Sequence {
    /// `len` frames in the room of `seed`, at [`FRAMES_PER_SECOND`]. The camera path is a closed
    /// loop of [`FRAMES_PER_LOOP`] frames whatever `len` is: fewer frames cut it short, more repeat
    /// it.
    pub fn new(seed: u64, len: usize, camera: Camera, sensor: SensorModel) -> Self {
        Self {
            seed,
            len,
            room: Arc::new(Room::new(seed)),
            way: Arc::new(Way::Loop(CameraPath::new(seed))),
            camera,
            sensor,
        }
    }

    /// `len` frames, at [`FRAMES_PER_SECOND`], of a walk through a row of rooms generated from
    /// `seed` and the seeds after it, from doorway to doorway. The frames are spread over the whole
    /// walk, so `len` sets the speed: [`FRAMES_PER_LOOP`] frames per room make a calm walking pace.
    /// For a single room this is the same as [`Self::new`].
    pub fn through_rooms(
        seed: u64,
        rooms: usize,
        len: usize,
        camera: Camera,
        sensor: SensorModel,
    ) -> Self {
        if rooms <= 1 {
            return Self::new(seed, len, camera, sensor);
        }
        let room = Room::row(seed, rooms);
        Self {
            seed,
            len,
            way: Arc::new(Way::Walk(Walk::new(seed, room.thresholds()))),
            room: Arc::new(room),
            camera,
            sensor,
        }
    }

    /// `len` frames, at [`FRAMES_PER_SECOND`], of a walk once round a ring of rooms generated from `seed`
    /// and the seeds after it, and on to the middle of the first room. The frames are spread over the
    /// whole walk. A ring has an even number of rooms, four or more; of others this is the same as
    /// [`Self::new`].
    pub fn around_rooms(
        seed: u64,
        rooms: usize,
        len: usize,
        camera: Camera,
        sensor: SensorModel,
    ) -> Self {
        if !Self::is_ring(rooms) {
            return Self::new(seed, len, camera, sensor);
        }
        let (room, ring) = Room::ring(seed, rooms / 2);
        Self {
            seed,
            len,
            way: Arc::new(Way::Round(Round::new(seed, ring))),
            room: Arc::new(room),
            camera,
            sensor,
        }
    }

    /// Whether [`around_rooms`](Self::around_rooms) goes round so many rooms.
    pub fn is_ring(rooms: usize) -> bool {
        rooms >= 4 && rooms.is_multiple_of(2)
    }

    /// The same sequence seen by another sensor; shares the room.
    pub fn with_sensor(&self, sensor: SensorModel) -> Self {
        Self {
            sensor,
            ..self.clone()
        }
    }

    /// The same sequence seen by another camera; shares the room.
    pub fn with_camera(&self, camera: Camera) -> Self {
        Self {
            camera,
            ..self.clone()
        }
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are no frames.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The camera of every frame.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The room.
    pub fn room(&self) -> &Room {
        &self.room
    }

    /// The ground-truth pose of frame `index`. Past the last frame, the loop in a single room goes
    /// on, while the walk through several rooms stays at its end.
    pub fn world_from_camera(&self, index: usize) -> Se3 {
        self.pose_at(index as f64)
    }

    /// Renders frame `index`, taken from [`Self::world_from_camera`], on all of rayon's threads.
    pub fn frame(&self, index: usize) -> RgbdFrame {
        let Picture { radiance, depth_m } = self.exposed(index);
        RgbdFrame::new(
            FrameIndex(index),
            index as f64 / FRAMES_PER_SECOND,
            self.sensor.develop(&radiance, self.seed, index),
            (self.sensor).measure(&depth_m, &self.camera, self.seed, index),
            self.camera,
        )
        .unwrap_or_else(|error| unreachable!("no sensor measures this: {error}"))
    }

    /// All frames in order.
    pub fn frames(&self) -> impl ExactSizeIterator<Item = RgbdFrame> + '_ {
        (0..self.len).map(|index| self.frame(index))
    }

    fn pose_at(&self, frame: f64) -> Se3 {
        match &*self.way {
            Way::Loop(path) => path.world_from_camera(frame / FRAMES_PER_LOOP as f64),
            Way::Walk(walk) => walk.world_from_camera(frame / (self.len.max(2) - 1) as f64),
            Way::Round(round) => round.world_from_camera(frame / (self.len.max(2) - 1) as f64),
        }
    }

    /// Exact depth at the middle of the exposure, and radiance averaged over it.
    fn exposed(&self, index: usize) -> Picture {
        if self.sensor.shutter == 0.0 {
            let view = View {
                camera: self.camera,
                world_from_camera: self.world_from_camera(index),
            };
            return render(&self.room, &view);
        }
        let poses: [Se3; EXPOSED_MOMENTS] = std::array::from_fn(|moment| {
            let offset = moment as f64 - (EXPOSED_MOMENTS / 2) as f64;
            self.pose_at(index as f64 + self.sensor.shutter * offset / EXPOSED_MOMENTS as f64)
        });
        render_moving(&self.room, &self.camera, &poses)
    }
}
