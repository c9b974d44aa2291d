//! Where frames are taken: a room, a way through it, and who else is there.

use std::sync::Arc;

use fgs_geom::{Camera, Se3};
use nalgebra::{UnitQuaternion, Vector3};

use crate::path::{CameraPath, FRAMES_PER_LOOP};
use crate::render::{Picture, render_moving};
use crate::room::Room;
use crate::sequence::EXPOSED_MOMENTS;

type Way = Box<dyn Fn(f64) -> Se3 + Send + Sync>;

/// A room and a way through it.
pub(super) struct Stage {
    room: Arc<Room>,
    /// Where the room lies in the world.
    world_from_room: Se3,
    /// `room_from_camera` by the point of the path, in frames of a normal motion.
    way: Way,
    guest: Option<Guest>,
}

/// Something that moves by itself.
pub(super) struct Guest {
    pub body: Room,
    /// `room_from_body`.
    pub way: Way,
}

impl Stage {
    pub fn new(room: Room, way: impl Fn(f64) -> Se3 + Send + Sync + 'static) -> Self {
        Self {
            room: Arc::new(room),
            world_from_room: Se3::identity(),
            way: Box::new(way),
            guest: None,
        }
    }

    /// The room of a seed and a hand-held camera's loop in it.
    pub fn furnished(seed: u64) -> Self {
        Self::with_loop(Room::new(seed), seed)
    }

    /// A room of the size of those that are generated from seeds, and the loop of a seed.
    pub fn with_loop(room: Room, seed: u64) -> Self {
        let path = CameraPath::new(seed);
        Self::new(room, move |at| {
            path.world_from_camera(at / FRAMES_PER_LOOP as f64)
        })
    }

    /// Far from all other rooms.
    pub fn elsewhere(self) -> Self {
        let far = Vector3::new(100.0, 0.0, 0.0);
        Self {
            world_from_room: Se3::new(UnitQuaternion::identity(), far),
            ..self
        }
    }

    pub fn with_guest(self, guest: Guest) -> Self {
        Self {
            guest: Some(guest),
            ..self
        }
    }

    pub fn world_from_camera(&self, at: f64) -> Se3 {
        self.world_from_room * (self.way)(at)
    }

    /// Exact depth and radiance, averaged over an exposure of `shutter` frames.
    pub fn picture(&self, camera: &Camera, at: f64, shutter: f64) -> Picture {
        let moments: [f64; EXPOSED_MOMENTS] = std::array::from_fn(|moment| {
            let offset = moment as f64 - (EXPOSED_MOMENTS / 2) as f64;
            at + shutter * offset / EXPOSED_MOMENTS as f64
        });
        let poses = moments.map(|at| (self.way)(at));
        let mut picture = render_moving(&self.room, camera, &poses);
        if let Some(guest) = &self.guest {
            let poses = moments.map(|at| (guest.way)(at).inverse() * (self.way)(at));
            picture.cover(&render_moving(&guest.body, camera, &poses));
        }
        picture
    }
}
