//! Small objects: books, ornaments, paintings, plants and lamps. Lengths are in metres.

use nalgebra::{Rotation3, Vector3};
use rand::RngExt;

use crate::builder::{Builder, Place};
use crate::pattern::{Pattern, Rgb, srgb};

/// Colours of book spines, sRGB.
const SPINES: [u32; 10] = [
    0x7a2e2e, 0x2e4a7a, 0x2f5d3a, 0xb08a3c, 0x46325c, 0x202428, 0xc9bfa6, 0x9a4a1f, 0x3d7d80,
    0xd0d4d8,
];
/// Accent colours for objects that are meant to stand out, sRGB.
pub(crate) const VIVID: [u32; 6] = [0xd1495b, 0xedae49, 0x2a9d8f, 0x3d6fa8, 0xe9e4d8, 0x7a4d8c];

/// Plain paint of an sRGB colour.
pub(crate) fn paint(hex: u32) -> Pattern {
    Pattern::Paint(srgb(hex))
}

/// A row of books from x = `from` to `to`, in a shelf with a clear height of `room`.
pub(crate) fn books(b: &mut Builder, at: Place, [from, to]: [f64; 2], room: f64) {
    let mut x = from;
    loop {
        let thick = b.between(0.018, 0.055);
        if x + thick > to {
            return;
        }
        let (high, deep) = (room * b.between(0.65, 0.95), b.between(0.15, 0.22));
        let pattern = Pattern::Spine(srgb(b.choose(SPINES)));
        if b.rng.random_bool(0.08) {
            // A leaning book takes more space.
            let lean = Rotation3::new(Vector3::new(0.0, 0.22, 0.0));
            let center = [x + 0.5 * thick + 0.05, 0.5 * deep + 0.03, 0.5 * high];
            b.turned_block(
                at,
                center,
                [0.5 * thick, 0.5 * deep, 0.48 * high],
                lean,
                pattern,
            );
            x += 0.12;
        } else {
            b.block(at, [x, 0.03, 0.0], [x + thick, 0.03 + deep, high], pattern);
            x += thick + 0.001;
        }
    }
}

/// A random small object for a table or shelf, within 0.12 m of (0, 0) and at most 0.3 m high.
pub(crate) fn ornament(b: &mut Builder, at: Place) {
    let vivid = paint(b.choose(VIVID));
    match b.rng.random_range(0..7) {
        0 => {
            let stone = Pattern::Marble {
                ground: srgb(0xe4e0d8),
                vein: srgb(0x3d5a80),
            };
            b.frustum(at, [0.0; 3], 0.14, [0.05, 0.09], stone);
            b.frustum(at, [0.0, 0.0, 0.14], 0.08, [0.09, 0.03], stone);
            b.frustum(at, [0.0, 0.0, 0.22], 0.05, [0.03, 0.045], stone);
        }
        1 => {
            b.frustum(
                at,
                [0.0; 3],
                0.02,
                [0.07, 0.06],
                Pattern::Wood(srgb(0x6b4526)),
            );
            b.ball(at, [0.0, 0.0, 0.15], [0.12; 3], Pattern::Globe);
        }
        2 => {
            b.frustum(
                at,
                [0.0; 3],
                0.06,
                [0.05, 0.12],
                Pattern::Wood(srgb(0xa9794b)),
            );
            for (x, y, color) in [
                (0.05, 0.0, 0xd9822b),
                (-0.04, 0.04, 0xb23a2e),
                (-0.02, -0.05, 0x9ab33f),
            ] {
                b.ball(at, [x, y, 0.08], [0.04; 3], paint(color));
            }
        }
        3 => {
            for i in 0..b.rng.random_range(2..5) {
                let z = 0.035 * f64::from(i);
                let turn = b.between(-0.4, 0.4);
                let stack = at.at([0.0, 0.0, z], turn);
                let spine = Pattern::Spine(srgb(b.choose(SPINES)));
                b.block(stack, [-0.11, -0.08, 0.0], [0.11, 0.08, 0.034], spine);
            }
        }
        4 => {
            b.frustum(at, [0.0; 3], 0.1, [0.04, 0.042], vivid);
            b.block(at, [0.04, -0.008, 0.02], [0.07, 0.008, 0.08], vivid);
        }
        5 => {
            let print = Pattern::Print {
                paper: srgb(0xe9e2cf),
                ink: srgb(0x2b2b33),
                line: 0.014,
            };
            b.block(at, [-0.1, -0.06, 0.0], [0.1, 0.06, 0.24], print);
        }
        _ => {
            b.frustum(at, [0.0; 3], 0.17, [0.035, 0.035], paint(0x2f5b3c));
            b.frustum(at, [0.0, 0.0, 0.17], 0.05, [0.035, 0.012], paint(0x2f5b3c));
            b.frustum(at, [0.0, 0.0, 0.22], 0.07, [0.012, 0.012], paint(0xc9bfa6));
        }
    }
}

/// A framed painting on the wall, centred at x = 0 and z = 0: 0.04 deep.
pub(crate) fn painting(b: &mut Builder, at: Place, [width, height]: [f64; 2]) {
    let (x, z) = (0.5 * width, 0.5 * height);
    let frame = Pattern::Wood(srgb(b.choose([0x3b2a1e, 0xa8895a, 0x22252a, 0xd8d2c4])));
    b.block(at, [-x - 0.04, 0.0, -z - 0.04], [x + 0.04, 0.03, -z], frame);
    b.block(at, [-x - 0.04, 0.0, z], [x + 0.04, 0.03, z + 0.04], frame);
    b.block(at, [-x - 0.04, 0.0, -z], [-x, 0.03, z], frame);
    b.block(at, [x, 0.0, -z], [x + 0.04, 0.03, z], frame);
    let picture = b.choose([
        Pattern::Landscape,
        Pattern::Landscape,
        Pattern::Abstract,
        Pattern::Blossoms,
    ]);
    b.block(at, [-x, 0.0, -z], [x, 0.02, z], picture);
}

/// A floor lamp, 1.6 high, within 0.22 of the origin.
pub(crate) fn floor_lamp(b: &mut Builder, at: Place) {
    b.frustum(at, [0.0; 3], 0.03, [0.15, 0.14], paint(0x2a2a2d));
    b.frustum(at, [0.0, 0.0, 0.03], 1.3, [0.014, 0.012], paint(0xb39b62));
    b.frustum(
        at,
        [0.0, 0.0, 1.3],
        0.3,
        [0.22, 0.14],
        Pattern::Cloth(srgb(0xf3dfb4)),
    );
    b.light_up_last(0.7);
    b.lamp(
        at,
        [0.0, 0.0, 1.45],
        [0.1, 0.1, 0.1],
        Rgb::new(1.0, 0.8, 0.5) * 0.7,
    );
}

/// A potted plant centred at the origin, up to 1.2 high and 0.5 wide.
pub(crate) fn plant(b: &mut Builder, at: Place) {
    let pot = b.choose([
        Pattern::Terrazzo(srgb(0xd8d2c6)),
        paint(0xb5623c),
        Pattern::Cloth(srgb(0xc8b48c)),
    ]);
    b.frustum(at, [0.0; 3], 0.32, [0.13, 0.18], pot);
    b.frustum(at, [0.0, 0.0, 0.32], 0.01, [0.16, 0.16], paint(0x3a2a1c));
    let green = srgb(b.choose([0x3f6b35, 0x55803c, 0x2f5a44]));
    for i in 0..22 {
        // Successive leaves turn by the golden angle; the lower ones spread wider.
        let azimuth = 2.399_963 * f64::from(i);
        let lift = 0.35 + 0.95 * f64::from(i) / 22.0 + b.between(-0.1, 0.1);
        let length = b.between(0.16, 0.26);
        let stem = 0.38 + 0.4 * f64::from(i) / 22.0;
        let tilt = Rotation3::from_axis_angle(&Vector3::z_axis(), azimuth)
            * Rotation3::from_axis_angle(&Vector3::x_axis(), lift);
        let center = Vector3::new(0.0, 0.0, stem) + tilt * Vector3::new(0.0, length + 0.02, 0.0);
        let leaf = Pattern::Leaf(green * b.between(0.8, 1.25) as f32);
        b.turned_block(at, center.into(), [0.3 * length, length, 0.003], tilt, leaf);
    }
}

/// A pendant lamp that hangs from the ceiling at `height`.
pub(crate) fn pendant(b: &mut Builder, at: Place, height: f64) {
    b.frustum(
        at,
        [0.0, 0.0, height - 0.45],
        0.45,
        [0.008, 0.008],
        paint(0x222222),
    );
    b.frustum(
        at,
        [0.0, 0.0, height - 0.65],
        0.2,
        [0.26, 0.1],
        Pattern::Cloth(srgb(0xefe3c8)),
    );
    b.light_up_last(0.8);
    b.lamp(
        at,
        [0.0, 0.0, height - 0.62],
        [0.15, 0.15, 0.02],
        Rgb::new(1.0, 0.88, 0.7) * 2.2,
    );
}
