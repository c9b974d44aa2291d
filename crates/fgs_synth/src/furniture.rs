//! Pieces of furniture. Unless stated otherwise each stands in its local frame with its back at
//! y = 0, its left end (seen from behind) at x = 0, and its feet at z = 0. Lengths are in metres.

use std::f64::consts::PI;

use rand::RngExt;

use crate::builder::{Builder, Place};
use crate::decor::{VIVID, books, ornament, paint};
use crate::pattern::{Pattern, Rgb, srgb};

/// Clear width and height of a doorway, and the outer half width of its frame.
pub(crate) const DOORWAY_WIDTH_M: f64 = 1.0;
pub(crate) const DOORWAY_HEIGHT_M: f64 = 2.1;
pub(crate) const DOORWAY_REACH_M: f64 = 0.58;

/// Upholstery colours, sRGB.
const CLOTHS: [u32; 6] = [0x5a6f86, 0x8c4a3c, 0x6d7a52, 0xb59a6a, 0x4a4a56, 0xa9a49a];

/// A bookcase with books and ornaments: 0.32 deep.
pub(crate) fn bookcase(b: &mut Builder, at: Place, width: f64, height: f64, wood: Rgb) {
    const BOARD: f64 = 0.025;
    let board = Pattern::Wood(wood);
    b.block(at, [0.0, 0.0, 0.0], [BOARD, 0.32, height], board);
    b.block(at, [width - BOARD, 0.0, 0.0], [width, 0.32, height], board);
    b.block(at, [BOARD, 0.0, 0.0], [width - BOARD, 0.02, height], board);
    let count = (height / 0.36) as usize;
    let step = (height - BOARD) / count as f64;
    for i in 0..=count {
        let z = step * i as f64;
        b.block(
            at,
            [BOARD, 0.02, z],
            [width - BOARD, 0.32, z + BOARD],
            board,
        );
        if i == count {
            break;
        }
        let shelf = at.at([0.0, 0.02, z + BOARD], 0.0);
        let split = b.between(0.45, 1.0) * width;
        let clear = step - BOARD;
        if b.rng.random_bool(0.5) {
            books(b, shelf, [BOARD + 0.01, split], clear);
            if width - split > 0.3 {
                let x = 0.5 * (split + width);
                ornament(b, shelf.at([x, 0.15, 0.0], 0.0));
            }
        } else {
            books(
                b,
                shelf,
                [width - split.min(0.8 * width), width - BOARD - 0.01],
                clear,
            );
        }
    }
}

/// A sideboard with doors and with ornaments on top: 0.45 deep.
pub(crate) fn sideboard(b: &mut Builder, at: Place, width: f64, height: f64, wood: Rgb) {
    let doors = (width / 0.45).round().max(1.0);
    b.block(
        at,
        [0.02, 0.02, 0.0],
        [width - 0.02, 0.4, 0.08],
        paint(0x2a2623),
    );
    b.block(
        at,
        [0.0, 0.0, 0.08],
        [width, 0.42, height],
        Pattern::Wood(wood),
    );
    b.block(
        at,
        [-0.02, 0.0, height],
        [width + 0.02, 0.45, height + 0.03],
        Pattern::Wood(wood * 0.7),
    );
    for i in 0..doors as usize {
        let (left, right) = (width / doors * i as f64, width / doors * (i + 1) as f64);
        let door = Pattern::Wood(wood * 1.15);
        b.block(
            at,
            [left + 0.01, 0.42, 0.1],
            [right - 0.01, 0.44, height - 0.02],
            door,
        );
        let x = if i % 2 == 0 {
            right - 0.05
        } else {
            left + 0.05
        };
        b.ball(at, [x, 0.455, 0.7 * height], [0.015; 3], paint(0xc8b27a));
    }
    let mut x = 0.2;
    while x < width - 0.15 {
        ornament(b, at.at([x, 0.2, height + 0.03], 0.0));
        x += b.between(0.3, 0.6);
    }
}

/// A sofa with cushions: 0.9 deep, 0.85 high.
pub(crate) fn sofa(b: &mut Builder, at: Place, width: f64) {
    let cloth = Pattern::Cloth(srgb(b.choose(CLOTHS)));
    b.block(at, [0.0, 0.0, 0.1], [width, 0.88, 0.3], cloth);
    b.block(at, [0.0, 0.0, 0.3], [width, 0.22, 0.85], cloth);
    for x in [0.0, width - 0.18] {
        b.block(at, [x, 0.22, 0.3], [x + 0.18, 0.88, 0.6], cloth);
        for y in [0.08, 0.8] {
            b.frustum(
                at,
                [x + 0.09, y, 0.0],
                0.1,
                [0.02, 0.03],
                Pattern::Wood(srgb(0x5b3a22)),
            );
        }
    }
    let seats = ((width - 0.36) / 0.7).round().max(1.0);
    let seat = (width - 0.36) / seats;
    for i in 0..seats as usize {
        let x = 0.18 + seat * i as f64;
        b.block(
            at,
            [x + 0.005, 0.22, 0.3],
            [x + seat - 0.005, 0.9, 0.44],
            cloth,
        );
        let stripes = Pattern::Stripes {
            colors: [srgb(b.choose(VIVID)), srgb(0xe9e2d2)],
            period: 0.08,
        };
        let cushion = b.choose([Pattern::Cloth(srgb(0xc46a3a)), stripes, Pattern::Blossoms]);
        let center = [x + seat * b.between(0.3, 0.7), 0.33, 0.62];
        b.ball(at, center, [0.22, 0.1, 0.19], cushion);
    }
}

/// A table on four legs, centred at the origin of its frame.
pub(crate) fn table(b: &mut Builder, at: Place, [wide, deep, high]: [f64; 3], top: Pattern) {
    let (x, y) = (0.5 * wide, 0.5 * deep);
    b.block(at, [-x, -y, high - 0.035], [x, y, high], top);
    let leg = Pattern::Wood(srgb(0x5e3f28));
    for (sx, sy) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let foot = [sx * (x - 0.07), sy * (y - 0.07), 0.0];
        b.frustum(at, foot, high - 0.035, [0.025, 0.035], leg);
    }
}

/// A chair centred at the origin of its frame and facing y: 0.45 square, 0.92 high.
pub(crate) fn chair(b: &mut Builder, at: Place, wood: Rgb) {
    let board = Pattern::Wood(wood);
    let cloth = Pattern::Cloth(srgb(b.choose(CLOTHS)));
    b.block(at, [-0.21, -0.21, 0.43], [0.21, 0.21, 0.46], board);
    b.block(at, [-0.19, -0.18, 0.46], [0.19, 0.2, 0.49], cloth);
    for x in [-0.2, 0.17] {
        b.block(at, [x, -0.21, 0.0], [x + 0.03, -0.18, 0.92], board);
        b.block(at, [x, 0.18, 0.0], [x + 0.03, 0.21, 0.43], board);
    }
    for z in [0.58, 0.7, 0.82] {
        b.block(at, [-0.17, -0.205, z], [0.17, -0.185, z + 0.07], board);
    }
}

/// A desk against the wall with a screen, papers and a chair: 1.4 wide, 0.65 deep.
pub(crate) fn desk(b: &mut Builder, at: Place, wood: Rgb) {
    table(
        b,
        at.at([0.7, 0.33, 0.0], 0.0),
        [1.4, 0.65, 0.75],
        Pattern::Wood(wood),
    );
    b.block(
        at,
        [0.95, 0.05, 0.1],
        [1.35, 0.6, 0.7],
        Pattern::Wood(wood * 0.8),
    );
    for z in [0.15, 0.35, 0.54] {
        b.block(
            at,
            [0.97, 0.6, z],
            [1.33, 0.615, z + 0.15],
            Pattern::Wood(wood * 1.1),
        );
    }
    let desk = at.at([0.0, 0.0, 0.75], 0.0);
    b.block(desk, [0.55, 0.12, 0.0], [0.85, 0.3, 0.015], paint(0x1d1f22));
    b.block(
        desk,
        [0.68, 0.16, 0.015],
        [0.72, 0.19, 0.16],
        paint(0x1d1f22),
    );
    b.block(desk, [0.4, 0.18, 0.12], [1.0, 0.21, 0.48], paint(0x17181b));
    let screen = Pattern::Print {
        paper: srgb(0x1b2a3a),
        ink: srgb(0x9fd3c7),
        line: 0.022,
    };
    b.block(desk, [0.415, 0.21, 0.135], [0.985, 0.213, 0.465], screen);
    let keys = Pattern::Tiles {
        colors: [srgb(0x3a3d42), srgb(0x3a3d42)],
        side: 0.02,
    };
    b.block(desk, [0.5, 0.36, 0.0], [0.94, 0.5, 0.02], keys);
    let paper = Pattern::Print {
        paper: srgb(0xf2efe6),
        ink: srgb(0x2a2a30),
        line: 0.012,
    };
    b.block(
        desk.at([0.22, 0.4, 0.0], 0.3),
        [-0.1, -0.14, 0.0],
        [0.11, 0.15, 0.004],
        paper,
    );
    books(b, desk.at([0.0, 0.02, 0.0], 0.0), [0.06, 0.36], 0.3);
    ornament(b, desk.at([1.2, 0.25, 0.0], 0.0));
    chair(b, at.at([0.6, 0.85, 0.0], PI - 0.35), wood * 0.7);
}

/// A window with frame, sill and curtains, centred at x = 0, from z = 0.9 to 2.1: 0.2 deep.
pub(crate) fn window(b: &mut Builder, at: Place, width: f64) {
    let (x, low, high) = (0.5 * width, 0.9, 2.1);
    b.block(at, [-x, 0.0, low], [x, 0.01, high], Pattern::Landscape);
    b.light_up_last(0.35);
    let white = paint(0xe8e6e0);
    for edge in [-x - 0.05, -0.025, x] {
        b.block(at, [edge, 0.0, low], [edge + 0.05, 0.06, high], white);
    }
    b.block(
        at,
        [-x - 0.05, 0.0, high],
        [x + 0.05, 0.06, high + 0.06],
        white,
    );
    b.block(at, [-x - 0.1, 0.0, low - 0.05], [x + 0.1, 0.2, low], white);
    let cloth = Pattern::Cloth(srgb(b.choose([0xc9b79c, 0x8fa3a8, 0xb0705c, 0xd9d4c8])));
    b.block(
        at,
        [-x - 0.5, 0.09, high + 0.11],
        [x + 0.5, 0.11, high + 0.13],
        Pattern::Wood(srgb(0x5b3a22)),
    );
    for side in [-1.0, 1.0] {
        // The folds of a curtain.
        for i in 0..6 {
            let fold = [side * (x + 0.1 + 0.065 * f64::from(i)), 0.1, 0.08];
            let radius = 0.035 + 0.012 * f64::from(i % 2);
            b.frustum(at, fold, high + 0.03, [radius, 0.9 * radius], cloth);
        }
    }
    let daylight = Rgb::new(0.75, 0.9, 1.1) * 2.2;
    b.lamp(at, [0.0, 0.3, 1.5], [x, 0.05, 0.5], daylight);
}

/// A radiator under a window, centred at x = 0: 0.13 deep, 0.7 high.
pub(crate) fn radiator(b: &mut Builder, at: Place, width: f64) {
    let count = (width / 0.08) as usize;
    for i in 0..count {
        let x = 0.08 * i as f64 - 0.5 * width;
        b.block(at, [x, 0.03, 0.12], [x + 0.06, 0.13, 0.7], paint(0xdedcd6));
    }
}

/// A closed door centred at x = 0: 0.06 deep, 2.05 high.
pub(crate) fn door(b: &mut Builder, at: Place, wood: Rgb) {
    let frame = Pattern::Wood(wood * 0.8);
    b.block(at, [-0.5, 0.0, 0.0], [-0.42, 0.06, 2.08], frame);
    b.block(at, [0.42, 0.0, 0.0], [0.5, 0.06, 2.08], frame);
    b.block(at, [-0.42, 0.0, 2.0], [0.42, 0.06, 2.08], frame);
    b.block(
        at,
        [-0.42, 0.0, 0.0],
        [0.42, 0.03, 2.0],
        Pattern::Wood(wood),
    );
    for (low, high) in [(0.15, 0.85), (1.0, 1.85)] {
        for (left, right) in [(-0.33, -0.04), (0.04, 0.33)] {
            b.block(
                at,
                [left, 0.03, low],
                [right, 0.042, high],
                Pattern::Wood(wood * 1.15),
            );
        }
    }
    b.ball(at, [-0.36, 0.08, 1.02], [0.03; 3], paint(0xc2a860));
}

/// The frame of an open doorway centred at x = 0: 0.06 deep.
pub(crate) fn doorway(b: &mut Builder, at: Place, wood: Rgb) {
    let frame = Pattern::Wood(wood * 0.8);
    let (side, top, reach) = (0.5 * DOORWAY_WIDTH_M, DOORWAY_HEIGHT_M, DOORWAY_REACH_M);
    b.block(at, [-reach, 0.0, 0.0], [-side, 0.06, top], frame);
    b.block(at, [side, 0.0, 0.0], [reach, 0.06, top], frame);
    b.block(at, [-reach, 0.0, top], [reach, 0.06, top + 0.08], frame);
}
