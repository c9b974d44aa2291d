//! Room layout: walls, floor and ceiling, furniture along each wall, and a middle that is clear
//! above table height for the camera path.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::Vector3;
use rand::RngExt;
use rand::seq::SliceRandom;

use crate::builder::{Builder, Place};
use crate::decor;
use crate::furniture as f;
use crate::pattern::{Pattern, Rgb, srgb};

/// Thickness of a wall, metres.
pub(crate) const WALL_M: f64 = 0.2;

/// Left clear at both ends of a wall for the corner and for the furniture along the adjacent wall,
/// metres.
const CORNER_M: f64 = 0.62;

/// A piece of furniture along a wall, or a door or window in it.
#[derive(Clone, Copy)]
enum Item {
    Bookcase,
    Sideboard,
    Sofa,
    Desk,
    Door,
    Window,
}

impl Item {
    fn width(self) -> f64 {
        match self {
            Self::Bookcase => 1.05,
            Self::Sideboard => 1.3,
            Self::Sofa => 2.0,
            Self::Desk => 1.4,
            Self::Door => 1.0,
            Self::Window => 2.4,
        }
    }

    fn put(self, b: &mut Builder, at: Place, wood: Rgb) {
        let middle = 0.5 * self.width();
        let above = |b: &mut Builder, z: f64, tall: f64| {
            let size = [b.between(1.1, 1.6) * tall, tall];
            decor::painting(b, at.at([middle, 0.0, z], 0.0), size);
        };
        match self {
            Self::Bookcase => {
                let height = b.between(1.8, 2.15);
                f::bookcase(b, at, self.width(), height, wood);
            }
            Self::Sideboard => {
                f::sideboard(b, at, self.width(), 0.8, wood);
                above(b, 1.65, 0.62);
            }
            Self::Sofa => {
                f::sofa(b, at, self.width());
                above(b, 1.55, 0.8);
            }
            Self::Desk => {
                f::desk(b, at, wood);
                above(b, 1.75, 0.5);
            }
            Self::Door => f::door(b, at.at([middle, 0.0, 0.0], 0.0), wood),
            Self::Window => {
                let at = at.at([middle, 0.0, 0.0], 0.0);
                f::window(b, at, 1.4);
                f::radiator(b, at, 1.2);
            }
        }
    }
}

/// The plan of a room to furnish.
pub(crate) struct Plan {
    /// Frame at the middle of its floor.
    pub middle: Place,
    /// Inner width (x), depth (y) and height (z), metres.
    pub size: Vector3<f64>,
    /// 0: living room, 1: study, 2: dining room.
    pub kind: u64,
    /// Whether the walls at -y, +x, +y and -x have a doorway in their middle.
    pub doorways: [bool; 4],
}

/// Draws the inner size of the next room, metres.
pub(crate) fn size(b: &mut Builder) -> Vector3<f64> {
    Vector3::new(
        b.between(5.0, 5.8),
        b.between(4.6, 5.2),
        b.between(2.5, 2.75),
    )
}

/// Adds the walls, furniture and lamps of a room.
pub(crate) fn furnish(b: &mut Builder, plan: &Plan) {
    let wood = srgb(b.choose([0x8a5a36, 0xb98a5a, 0x5f4030, 0xc9b08c]));
    shell(b, plan);
    let mut walls = match plan.kind {
        0 => [
            vec![Item::Sofa, Item::Bookcase],
            vec![Item::Window],
            vec![Item::Sideboard, Item::Bookcase],
            vec![Item::Door, Item::Sideboard],
        ],
        1 => [
            vec![Item::Desk, Item::Bookcase],
            vec![Item::Bookcase, Item::Bookcase],
            vec![Item::Window, Item::Bookcase],
            vec![Item::Door, Item::Sideboard],
        ],
        _ => [
            vec![Item::Sideboard, Item::Sideboard],
            vec![Item::Window],
            vec![Item::Bookcase, Item::Sideboard],
            vec![Item::Door, Item::Bookcase],
        ],
    };
    if plan.doorways != [false; 4] {
        // A doorway leaves no space for a window in its wall, so put one here, if there is none either.
        walls[2] = vec![Item::Window, Item::Bookcase];
    }
    for (items, wall) in walls.iter_mut().zip(plan.walls()) {
        if wall.has_doorway {
            beside_doorway(b, &wall, wood);
        } else {
            items.shuffle(&mut b.rng);
            stand_along(b, items, &wall, wood);
        }
    }
    corners(b, plan);
    middle(b, plan, wood);
}

/// The inner side of a wall.
struct Wall {
    /// Frame at its left end (seen from behind the wall), with y into the room.
    place: Place,
    length: f64,
    has_doorway: bool,
}

impl Plan {
    /// The walls at -y, +x, +y and -x.
    fn walls(&self) -> [Wall; 4] {
        let (x, y) = (0.5 * self.size.x, 0.5 * self.size.y);
        let wall = |corner: [f64; 2], yaw: f64, length: f64, has_doorway: bool| Wall {
            place: self.middle.at([corner[0], corner[1], 0.0], yaw),
            length,
            has_doorway,
        };
        [
            wall([-x, -y], 0.0, self.size.x, self.doorways[0]),
            wall([x, -y], FRAC_PI_2, self.size.y, self.doorways[1]),
            wall([x, y], PI, self.size.x, self.doorways[2]),
            wall([-x, y], -FRAC_PI_2, self.size.y, self.doorways[3]),
        ]
    }
}

fn stand_along(b: &mut Builder, items: &[Item], wall: &Wall, wood: Rgb) {
    let free = wall.length - 2.0 * CORNER_M - items.iter().map(|item| item.width()).sum::<f64>();
    let gap = free.max(0.0) / (items.len() + 1) as f64;
    let mut x = CORNER_M + gap;
    for item in items {
        item.put(b, wall.place.at([x, 0.0, 0.0], 0.0), wood);
        x += item.width() + gap;
    }
}

/// Adds the doorway's frame and a bookcase on either side.
fn beside_doorway(b: &mut Builder, wall: &Wall, wood: Rgb) {
    f::doorway(b, wall.place.at([0.5 * wall.length, 0.0, 0.0], 0.0), wood);
    let item = Item::Bookcase;
    for x in [CORNER_M, wall.length - CORNER_M - item.width()] {
        item.put(b, wall.place.at([x, 0.0, 0.0], 0.0), wood);
    }
}

fn shell(b: &mut Builder, plan: &Plan) {
    let Plan {
        middle: world,
        size,
        kind,
        doorways,
    } = *plan;
    let (x, y, z) = (0.5 * size.x, 0.5 * size.y, size.z);
    // Walls overlap at the corners, so that no ray slips through a seam.
    const T: f64 = WALL_M;
    let pale = srgb(b.choose([0xe8e0d0, 0xdcd8cc, 0xcfd8d6, 0xe6d9c4]));
    let floor = match kind {
        0 => Pattern::Planks(srgb(b.choose([0x9a6a42, 0xb58a5c, 0x7a5238]))),
        1 => Pattern::Planks(srgb(b.choose([0x6f4a30, 0x8a6a4c]))),
        _ => Pattern::Tiles {
            colors: b.choose([
                [srgb(0xd9d2c4), srgb(0x6d7a80)],
                [srgb(0xcdbfa8), srgb(0x9a5a40)],
            ]),
            side: 0.33,
        },
    };
    let accent = match kind {
        0 => Pattern::Wallpaper {
            ground: srgb(0xd8cfb8),
            motif: srgb(b.choose([0x9aa88a, 0xb58f7a, 0x8fa0b0])),
        },
        1 => Pattern::Plaster(srgb(b.choose([0x5f7d78, 0x8a5548, 0x50617a]))),
        _ => Pattern::Bricks(srgb(b.choose([0xa8604a, 0xb58a70]))),
    };
    let accented = b.rng.random_range(0..4);
    // The walls at -y, +x, +y and -x.
    let slabs = [
        ([-x - T, -y - T, 0.0], [x + T, -y, z]),
        ([x, -y - T, 0.0], [x + T, y + T, z]),
        ([-x - T, y, 0.0], [x + T, y + T, z]),
        ([-x - T, -y - T, 0.0], [-x, y + T, z]),
    ];
    for (i, ((low, high), has_doorway)) in slabs.into_iter().zip(doorways).enumerate() {
        let pattern = if i == accented {
            accent
        } else {
            Pattern::Plaster(pale)
        };
        if has_doorway {
            let (side, top) = (0.5 * f::DOORWAY_WIDTH_M, f::DOORWAY_HEIGHT_M);
            // Along y in the walls at +x and -x, along x in the others.
            let along = i % 2;
            let with = |mut point: [f64; 3], at: f64| {
                point[along] = at;
                point
            };
            b.block(world, low, with(high, -side), pattern);
            b.block(world, with(low, side), high, pattern);
            let above = [low[0], low[1], top];
            b.block(world, with(above, -side), with(high, side), pattern);
        } else {
            b.block(world, low, high, pattern);
        }
    }
    b.block(world, [-x - T, -y - T, -T], [x + T, y + T, 0.0], floor);
    let white = Pattern::Paint(srgb(0xe9e7e2));
    b.block(world, [-x - T, -y - T, z], [x + T, y + T, z + T], white);
    for wall in plan.walls() {
        let (place, length) = (wall.place, wall.length);
        if wall.has_doorway {
            let left = 0.5 * length - f::DOORWAY_REACH_M;
            b.block(place, [0.0; 3], [left, 0.015, 0.09], white);
            let right = length - left;
            b.block(place, [right, 0.0, 0.0], [length, 0.015, 0.09], white);
        } else {
            b.block(place, [0.0, 0.0, 0.0], [length, 0.015, 0.09], white);
        }
        b.block(place, [0.0, 0.0, z - 0.07], [length, 0.05, z], white);
    }
}

fn corners(b: &mut Builder, plan: &Plan) {
    let (x, y) = (0.5 * plan.size.x - 0.36, 0.5 * plan.size.y - 0.36);
    let mut points = [[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]];
    points.shuffle(&mut b.rng);
    let [first, second, third, fourth] = points.map(|point| plan.middle.at(point, 0.0));
    decor::floor_lamp(b, first);
    decor::plant(b, second);
    decor::plant(b, third);
    // Two stacked cardboard boxes with labels.
    let card = Pattern::Print {
        paper: srgb(0xb08a5e),
        ink: srgb(0x5a4228),
        line: 0.05,
    };
    b.block(
        fourth.at([0.0; 3], 0.2),
        [-0.22, -0.2, 0.0],
        [0.22, 0.2, 0.38],
        card,
    );
    b.block(
        fourth.at([0.0; 3], -0.3),
        [-0.17, -0.15, 0.38],
        [0.17, 0.15, 0.66],
        card,
    );
}

fn middle(b: &mut Builder, plan: &Plan, wood: Rgb) {
    let (world, kind) = (plan.middle, plan.kind);
    let at = world.at([0.0; 3], b.between(-0.25, 0.25));
    let rug = b.choose([
        [0x7a2430, 0xd9c08a, 0x2c3350],
        [0x2f4a5f, 0xe0d6c0, 0xb0623c],
        [0xb8a888, 0x5a4636, 0x8a3a2c],
    ]);
    b.block(
        at,
        [-1.2, -0.85, 0.0],
        [1.2, 0.85, 0.012],
        Pattern::Rug(rug.map(srgb)),
    );
    if kind == 2 {
        f::table(b, at, [1.5, 0.9, 0.75], Pattern::Wood(wood));
        for (x, yaw) in [(-0.4, 0.0), (0.4, 0.0), (-0.4, PI), (0.4, PI)] {
            let y = if yaw == 0.0 { -0.62 } else { 0.62 };
            let (slide, turn) = (b.between(-0.06, 0.06), b.between(-0.3, 0.3));
            f::chair(b, at.at([x + slide, y, 0.0], yaw + turn), wood * 0.8);
        }
    } else {
        let stone = Pattern::Marble {
            ground: srgb(0xd8d4cc),
            vein: srgb(0x6a6a70),
        };
        let top = b.choose([stone, Pattern::Wood(wood)]);
        f::table(b, at, [1.1, 0.6, 0.45], top);
    }
    let top = if kind == 2 { 0.75 } else { 0.45 };
    for x in [-0.35, 0.0, 0.33] {
        let (y, yaw) = (b.between(-0.12, 0.12), b.between(-PI, PI));
        decor::ornament(b, at.at([x, y, top], yaw));
    }
    decor::pendant(b, world, plan.size.z);
}
