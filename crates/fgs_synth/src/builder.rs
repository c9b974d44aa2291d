//! Assembles the solids and lamps of a room, each given in the local frame of its piece of
//! furniture.

use nalgebra::{Rotation3, Vector3};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use crate::light::Lamp;
use crate::pattern::{Pattern, Rgb};
use crate::room::Finish;
use crate::shape::{Form, Solid};

/// The local frame of a piece of furniture: x to the right seen from behind, y to the front, z up.
#[derive(Clone, Copy)]
pub(crate) struct Place {
    origin: Vector3<f64>,
    world_from_place: Rotation3<f64>,
}

impl Place {
    /// A frame at `origin`, metres, turned about z by `yaw` (rad), which takes x towards y.
    pub fn new(origin: [f64; 3], yaw: f64) -> Self {
        Self {
            origin: origin.into(),
            world_from_place: Rotation3::from_axis_angle(&Vector3::z_axis(), yaw),
        }
    }

    /// A child frame at `point` of this frame, turned about z by a further `yaw` (rad).
    pub fn at(&self, point: [f64; 3], yaw: f64) -> Self {
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), yaw);
        Self {
            origin: self.to_world(point),
            world_from_place: self.world_from_place * turn,
        }
    }

    fn to_world(self, point: [f64; 3]) -> Vector3<f64> {
        self.origin + self.world_from_place * Vector3::from(point)
    }
}

/// A room under construction.
pub(crate) struct Builder {
    pub solids: Vec<Solid>,
    pub finishes: Vec<Finish>,
    pub lamps: Vec<Lamp>,
    pub rng: Pcg64Mcg,
}

impl Builder {
    pub fn new(rng: Pcg64Mcg) -> Self {
        Self {
            solids: Vec::new(),
            finishes: Vec::new(),
            lamps: Vec::new(),
            rng,
        }
    }

    /// A uniform random number from `low` to `high`.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        self.rng.random_range(low..high)
    }

    /// A random element of `choices`.
    pub fn choose<T: Copy, const N: usize>(&mut self, choices: [T; N]) -> T {
        choices[self.rng.random_range(0..N)]
    }

    /// An axis-aligned block (in the frame `at`) between two opposite corners.
    pub fn block(&mut self, at: Place, low: [f64; 3], high: [f64; 3], pattern: Pattern) {
        let middle = std::array::from_fn(|i| 0.5 * (low[i] + high[i]));
        let half = Vector3::from_fn(|i, _| 0.5 * (high[i] - low[i]));
        self.solid(
            at,
            Form::Block,
            half,
            middle,
            Rotation3::identity(),
            pattern,
        );
    }

    /// A block with this centre and these half extents, rotated by `turn` in the frame `at`.
    pub fn turned_block(
        &mut self,
        at: Place,
        center: [f64; 3],
        half: [f64; 3],
        turn: Rotation3<f64>,
        pattern: Pattern,
    ) {
        self.solid(at, Form::Block, half.into(), center, turn, pattern);
    }

    /// An ellipsoid with this centre and these semi-axes.
    pub fn ball(&mut self, at: Place, center: [f64; 3], half: [f64; 3], pattern: Pattern) {
        let turn = Rotation3::identity();
        self.solid(at, Form::Ball, half.into(), center, turn, pattern);
    }

    /// An upright truncated cone or cylinder with these bottom and top radii. The point given is
    /// the centre of its base.
    pub fn frustum(
        &mut self,
        at: Place,
        [x, y, z]: [f64; 3],
        height: f64,
        [bottom, top]: [f64; 2],
        pattern: Pattern,
    ) {
        let radius = bottom.max(top);
        let half = Vector3::new(radius, radius, 0.5 * height);
        let form = Form::Frustum { bottom, top };
        let center = [x, y, z + 0.5 * height];
        self.solid(at, form, half, center, Rotation3::identity(), pattern);
    }

    /// An invisible light source.
    pub fn lamp(&mut self, at: Place, center: [f64; 3], half: [f64; 3], power: Rgb) {
        self.lamps.push(Lamp {
            center: at.to_world(center),
            half: (at.world_from_place.matrix() * Vector3::from(half)).abs(),
            power,
        });
    }

    /// Makes the solid added last emit `glow` times its albedo.
    pub fn light_up_last(&mut self, glow: f32) {
        if let Some(finish) = self.finishes.last_mut() {
            finish.glow = glow;
        }
    }

    fn solid(
        &mut self,
        at: Place,
        form: Form,
        half: Vector3<f64>,
        center: [f64; 3],
        turn: Rotation3<f64>,
        pattern: Pattern,
    ) {
        let turn = at.world_from_place * turn;
        self.solids
            .push(Solid::new(form, half, at.to_world(center), turn));
        self.finishes.push(Finish {
            pattern,
            seed: self.rng.random(),
            glow: 0.0,
        });
    }
}
