//! Procedural textures, from flat paint to fine print.
//!
//! A pattern maps a point on a face to its albedo (the fraction of light it reflects, linear RGB).
//! It does not depend on the viewpoint, except that noise finer than a pixel is filtered out.

use nalgebra::Vector3;

use crate::noise::{fbm, unit, value_noise};
use crate::picture;

/// Linear red, green and blue.
pub(crate) type Rgb = Vector3<f32>;

/// Linear colour from an sRGB hex value such as `0xff8800`.
pub(crate) fn srgb(hex: u32) -> Rgb {
    Rgb::new(
        (hex >> 16) as f32,
        (hex >> 8 & 255) as f32,
        (hex & 255) as f32,
    )
    .map(|channel| {
        let value = channel / 255.0;
        if value <= 0.04045 {
            value / 12.92
        } else {
            ((value + 0.055) / 1.055).powf(2.4)
        }
    })
}

/// Where a pattern is evaluated.
#[derive(Clone, Copy)]
pub(crate) struct Spot {
    /// Texture coordinate on the face, metres.
    pub u: f32,
    /// Likewise; points up on upright faces.
    pub v: f32,
    /// Extents of the face, metres.
    pub size: [f32; 2],
    /// Footprint of a pixel on the face, metres.
    pub footprint: f32,
    /// Varies the pattern from face to face.
    pub seed: u32,
}

impl Spot {
    /// Fractal noise whose first octave has wavelengths of `along_u` and `along_v` metres.
    pub fn noise(&self, along_u: f32, along_v: f32, octaves: u32) -> f32 {
        let uv = [self.u / along_u, self.v / along_v];
        let footprint = self.footprint / along_u.min(along_v);
        fbm(uv, self.seed, 1.0, octaves, footprint)
    }
}

/// What a surface is made of. Lengths are in metres.
#[derive(Clone, Copy)]
pub(crate) enum Pattern {
    /// One colour.
    Paint(Rgb),
    /// Painted plaster, slightly uneven.
    Plaster(Rgb),
    /// A board with the grain along its longer side.
    Wood(Rgb),
    /// Floorboards in several tones.
    Planks(Rgb),
    /// Tiles in a checkerboard with grout joints.
    Tiles { colors: [Rgb; 2], side: f32 },
    /// Brickwork with mortar joints.
    Bricks(Rgb),
    /// Stripes along v, two per period.
    Stripes { colors: [Rgb; 2], period: f32 },
    /// Wallpaper with rows of flower-like motifs.
    Wallpaper { ground: Rgb, motif: Rgb },
    /// Coarse cloth.
    Cloth(Rgb),
    /// A bordered rug with rows of diamonds.
    Rug([Rgb; 3]),
    /// Veined stone.
    Marble { ground: Rgb, vein: Rgb },
    /// Chips of stone in cement.
    Terrazzo(Rgb),
    /// Lines of text, each `line` high.
    Print { paper: Rgb, ink: Rgb, line: f32 },
    /// A book spine with bands and a title.
    Spine(Rgb),
    /// A leaf with veins.
    Leaf(Rgb),
    /// A painted landscape that fills the face.
    Landscape,
    /// A painting of overlapping discs and bars that fills the face.
    Abstract,
    /// A painting of flowers that fills the face.
    Blossoms,
    /// A globe with land and sea.
    Globe,
}

impl Pattern {
    pub fn albedo(&self, spot: &Spot) -> Rgb {
        match *self {
            Self::Paint(color) => color,
            Self::Plaster(color) => color * (1.0 + 0.05 * spot.noise(0.9, 0.9, 2)),
            Self::Wood(color) => wood(color, spot),
            Self::Planks(color) => planks(color, spot),
            Self::Tiles { colors, side } => tiles(colors, side, spot),
            Self::Bricks(color) => bricks(color, spot),
            Self::Stripes { colors, period } => {
                colors[usize::from((spot.u / period).rem_euclid(1.0) < 0.5)]
            }
            Self::Wallpaper { ground, motif } => wallpaper(ground, motif, spot),
            Self::Cloth(color) => {
                // A weave of 8 mm threads as noise, which fades out before it would alias.
                let weave = value_noise(spot.u / 0.008, spot.v / 0.008, spot.seed);
                let visible = (0.006 / spot.footprint - 1.0).clamp(0.0, 1.0);
                color * (1.0 + 0.12 * visible * weave + 0.07 * spot.noise(0.25, 0.25, 2))
            }
            Self::Rug(colors) => rug(colors, spot),
            Self::Marble { ground, vein } => {
                let bent = spot.u + 0.6 * spot.v + 0.25 * spot.noise(0.5, 0.5, 5);
                let line = 1.0 - (bent * 11.0).sin().abs();
                let share = line.powi(6) + 0.15 * (1.0 + spot.noise(0.2, 0.2, 3));
                ground.lerp(&vein, share.clamp(0.0, 1.0))
            }
            Self::Terrazzo(color) => terrazzo(color, spot),
            Self::Print { paper, ink, line } => print(paper, ink, line, spot),
            Self::Spine(color) => spine(color, spot),
            Self::Leaf(color) => {
                let [width, length] = spot.size;
                let across = (spot.u / width - 0.5).abs();
                let rib = (across - 0.03).abs() < 0.03;
                let vein = ((spot.v / length * 7.0 - across * 4.0).rem_euclid(1.0)) < 0.12;
                color
                    * if rib || vein {
                        1.5
                    } else {
                        1.0 + 0.15 * spot.noise(0.05, 0.05, 2)
                    }
            }
            Self::Landscape => picture::landscape(spot),
            Self::Abstract => picture::abstract_painting(spot),
            Self::Blossoms => picture::blossoms(spot),
            Self::Globe => picture::globe(spot),
        }
    }
}

fn wood(color: Rgb, spot: &Spot) -> Rgb {
    let upright = spot.size[1] > spot.size[0];
    let (along, across) = if upright {
        (spot.v, spot.u)
    } else {
        (spot.u, spot.v)
    };
    let turned = Spot {
        u: along,
        v: across,
        ..*spot
    };
    let grain = turned.noise(0.6, 0.035, 3);
    let rings = (across * 60.0 + 5.0 * turned.noise(1.2, 0.25, 2)).sin();
    color * (1.0 + 0.22 * grain + 0.06 * rings)
}

fn planks(color: Rgb, spot: &Spot) -> Rgb {
    const WIDTH: f32 = 0.14;
    const LENGTH: f32 = 1.1;
    let row = (spot.v / WIDTH).floor();
    let shifted = spot.u + LENGTH * unit(row as i32, 0, spot.seed);
    let column = (shifted / LENGTH).floor();
    let (x, y) = (shifted - column * LENGTH, spot.v - row * WIDTH);
    if y < 0.004 || x < 0.004 {
        return color * 0.3;
    }
    let board = crate::noise::hash(row as i32, column as i32, spot.seed);
    let tone = 0.75 + 0.5 * (board & 255) as f32 / 255.0;
    let on_board = Spot {
        u: x,
        v: y,
        size: [LENGTH, WIDTH],
        seed: board,
        ..*spot
    };
    wood(color * tone, &on_board)
}

fn tiles(colors: [Rgb; 2], side: f32, spot: &Spot) -> Rgb {
    let (i, j) = ((spot.u / side).floor(), (spot.v / side).floor());
    let (x, y) = (spot.u - i * side, spot.v - j * side);
    if x.min(y) < 0.006 {
        return Rgb::repeat(0.25);
    }
    let (i, j) = (i as i32, j as i32);
    let tone = 0.92 + 0.16 * unit(i, j, spot.seed);
    colors[((i + j) & 1) as usize] * tone * (1.0 + 0.06 * spot.noise(0.12, 0.12, 3))
}

fn bricks(color: Rgb, spot: &Spot) -> Rgb {
    const HEIGHT: f32 = 0.075;
    const LENGTH: f32 = 0.25;
    const JOINT: f32 = 0.011;
    let row = (spot.v / HEIGHT).floor();
    let shifted = spot.u + 0.5 * LENGTH * (row as i32 & 1) as f32;
    let column = (shifted / LENGTH).floor();
    let (x, y) = (shifted - column * LENGTH, spot.v - row * HEIGHT);
    if x < JOINT || y < JOINT {
        return Rgb::repeat(0.42) * (1.0 + 0.1 * spot.noise(0.03, 0.03, 2));
    }
    let tone = 0.7 + 0.5 * unit(row as i32, column as i32, spot.seed);
    color * tone * (1.0 + 0.18 * spot.noise(0.05, 0.05, 3))
}

fn wallpaper(ground: Rgb, motif: Rgb, spot: &Spot) -> Rgb {
    const CELL: f32 = 0.24;
    let row = (spot.v / CELL).floor();
    let shifted = spot.u / CELL + 0.5 * (row as i32 & 1) as f32;
    let (x, y) = (
        2.0 * shifted.rem_euclid(1.0) - 1.0,
        2.0 * (spot.v / CELL - row) - 1.0,
    );
    let (radius, angle) = (x.hypot(y), y.atan2(x));
    let petals = 0.42 + 0.16 * (5.0 * angle).cos();
    if radius < 0.13
        || (radius - petals).abs() < 0.05
        || (radius < 0.85 && x.abs() < 0.03 && y < -0.55)
    {
        motif
    } else {
        ground
    }
}

fn rug(colors: [Rgb; 3], spot: &Spot) -> Rgb {
    let [width, height] = spot.size;
    let edge = spot.u.min(width - spot.u).min(spot.v.min(height - spot.v));
    let pile = 1.0 + 0.13 * spot.noise(0.012, 0.012, 2);
    let color = if edge < 0.05 {
        colors[0]
    } else if edge < 0.2 {
        let teeth = (spot.u / 0.1).rem_euclid(1.0) + (spot.v / 0.1).rem_euclid(1.0);
        colors[if (0.5..1.5).contains(&teeth) { 1 } else { 2 }]
    } else if edge < 0.23 {
        colors[2]
    } else {
        let (x, y) = (
            (spot.u - 0.5 * width) / 0.36,
            (spot.v - 0.5 * height) / 0.36,
        );
        let diamond = (x.rem_euclid(1.0) - 0.5).abs() + (y.rem_euclid(1.0) - 0.5).abs();
        colors[match diamond {
            d if d < 0.12 => 2,
            d if d < 0.28 => 0,
            d if d < 0.36 => 1,
            _ => 0,
        }]
    };
    color * pile
}

fn terrazzo(color: Rgb, spot: &Spot) -> Rgb {
    const CELL: f32 = 0.035;
    let (x, y) = (spot.u / CELL, spot.v / CELL);
    let (i, j) = (x.floor() as i32, y.floor() as i32);
    let (cx, cy) = (unit(i, j, spot.seed), unit(i, j, spot.seed ^ 1));
    let radius = 0.12 + 0.25 * unit(i, j, spot.seed ^ 2);
    let (dx, dy) = (x - i as f32 - cx, y - j as f32 - cy);
    let chip = (dx + 0.3 * dy).abs() + dy.abs() < radius;
    if chip {
        let tone = 0.35 + 0.9 * unit(i, j, spot.seed ^ 3);
        let warm = unit(i, j, spot.seed ^ 4);
        Rgb::new(
            color.x * tone,
            color.y * tone * (0.7 + 0.3 * warm),
            color.z * tone * warm,
        )
    } else {
        color
    }
}

/// Whether ink covers the point (x, y), in line heights from the lower left of the text.
fn inked(x: f32, y: f32, seed: u32) -> bool {
    // Letters are half a line height wide and made of strokes on a 2x3 grid.
    let (row, column) = (y.floor() as i32, (2.0 * x).floor() as i32);
    let (a, b) = ((2.0 * x).rem_euclid(1.0), y.rem_euclid(1.0));
    let letter = crate::noise::hash(column, row, seed);
    let gap = letter.is_multiple_of(6);
    if gap || !(0.15..0.85).contains(&a) || !(0.2..0.85).contains(&b) {
        return false;
    }
    let stroke = |bit: u32| letter >> (8 + bit) & 1 == 1;
    let (left, right) = (a < 0.33, a > 0.67);
    let (low, middle, high) = (b < 0.32, (0.48..0.6).contains(&b), b > 0.73);
    (left && stroke(u32::from(b > 0.54)))
        || (right && stroke(2 + u32::from(b > 0.54)))
        || (low && stroke(4))
        || (middle && stroke(5))
        || (high && stroke(6))
}

fn print(paper: Rgb, ink: Rgb, line: f32, spot: &Spot) -> Rgb {
    let margin = 1.5 * line;
    let [width, height] = spot.size;
    // The right margin is ragged, and every seventh line is blank.
    let row = ((spot.v - margin) / line).floor() as i32;
    let end = width - margin - 0.3 * width * unit(row, 7, spot.seed);
    let in_text = spot.u > margin
        && spot.u < end
        && spot.v > margin
        && spot.v < height - margin
        && row % 7 != 3;
    if in_text
        && inked(
            (spot.u - margin) / line,
            (spot.v - margin) / line,
            spot.seed,
        )
    {
        ink
    } else {
        paper
    }
}

fn spine(color: Rgb, spot: &Spot) -> Rgb {
    let [width, height] = spot.size;
    let light = Rgb::repeat(0.75).lerp(&color, 0.2);
    let v = spot.v / height;
    let band = |center: f32| (v - center).abs() < 0.02;
    if band(0.1) || band(0.86) {
        return light;
    }
    // The title runs up the middle.
    let letter = 0.5 * width;
    let in_title = (0.2..0.75).contains(&v) && (spot.u - 0.5 * width).abs() < 0.25 * width;
    let (x, y) = (
        (spot.v - 0.2 * height) / letter,
        (0.75 * width - spot.u) / letter,
    );
    if in_title && inked(x, y, spot.seed) {
        light
    } else {
        color
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_ends_and_middle() {
        assert_eq!(srgb(0), Rgb::zeros());
        assert!((srgb(0xffffff) - Rgb::repeat(1.0)).amax() <= 1e-6);
        // The sRGB value 188 is about half the linear intensity.
        assert!((srgb(0x00bc00).y - 0.5029).abs() <= 1e-3);
        assert_eq!(srgb(0x00bc00).x, 0.0);
    }

    #[test]
    fn albedo_is_finite_and_never_negative() {
        let color = srgb(0xc08040);
        let patterns = [
            Pattern::Plaster(color),
            Pattern::Wood(color),
            Pattern::Planks(color),
            Pattern::Tiles {
                colors: [color; 2],
                side: 0.3,
            },
            Pattern::Bricks(color),
            Pattern::Wallpaper {
                ground: color,
                motif: color,
            },
            Pattern::Cloth(color),
            Pattern::Rug([color; 3]),
            Pattern::Marble {
                ground: color,
                vein: color,
            },
            Pattern::Terrazzo(color),
            Pattern::Print {
                paper: color,
                ink: color,
                line: 0.01,
            },
            Pattern::Spine(color),
            Pattern::Leaf(color),
            Pattern::Landscape,
            Pattern::Abstract,
            Pattern::Blossoms,
            Pattern::Globe,
        ];
        for pattern in patterns {
            for i in 0..500 {
                let spot = Spot {
                    u: 0.9 * unit(i, 0, 1),
                    v: 0.6 * unit(i, 1, 1),
                    size: [0.9, 0.6],
                    footprint: 0.003,
                    seed: i as u32 / 50,
                };
                let albedo = pattern.albedo(&spot);
                assert!(albedo.min() >= 0.0 && albedo.max() <= 1.5, "{albedo}");
            }
        }
    }
}
