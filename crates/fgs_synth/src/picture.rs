//! Paintings: patterns that fill the whole face, with detail at every scale.

use std::f32::consts::PI;

use crate::noise::{fbm, unit, value_noise};
use crate::pattern::{Rgb, Spot, srgb};

/// A landscape: sky with clouds, three hazy ridges, a lake or a meadow, and fir trees.
pub(crate) fn landscape(spot: &Spot) -> Rgb {
    let seed = spot.seed;
    let height = spot.size[1];
    // Painting coordinates: y from 0 to 1, x on the same scale.
    let (x, y) = (spot.u / height, spot.v / height);
    let pixel = spot.footprint / height;
    let noise = |u: f32, v: f32, k: u32, wavelength: f32, octaves: u32| {
        fbm([u, v], seed ^ (0x100 * k), wavelength, octaves, pixel)
    };
    let dusk = unit(1, 0, seed);
    let zenith = srgb(0x3a6fb5).lerp(&srgb(0x2c2f66), dusk);
    let horizon = srgb(0xd5e6f2).lerp(&srgb(0xf6a35c), dusk);

    // Ridges from near to far: base, height, colour before haze.
    let ridges = [
        (0.30, 0.10, srgb(0x2f4a2a)),
        (0.42, 0.16, srgb(0x43603f)),
        (0.52, 0.30, srgb(0x6f7585)),
    ];
    for (k, (foot, tall, color)) in ridges.into_iter().enumerate() {
        let k = k as u32 + 1;
        let ridge = foot + 0.5 * tall * (1.0 + noise(x, 0.0, k, 0.5, 6));
        if k == 1 && fir(x, y - ridge, seed) {
            return srgb(0x16241a);
        }
        if y > ridge || y < 0.26 {
            continue;
        }
        let relief = noise(x + 0.7 * y, y, k + 4, 0.12, 5);
        let snow = k == 3 && y > 0.66 + 0.1 * noise(x, y, 9, 0.1, 4);
        let lit = (if snow { srgb(0xf2f4f8) } else { color }) * (1.0 + 0.5 * relief).max(0.2);
        return lit.lerp(&horizon, 0.22 * k as f32);
    }
    if y < 0.26 {
        return if hash_bit(seed) {
            let ripple = value_noise(x * 9.0, y * 120.0, seed ^ 0x31);
            let mirrored = zenith.lerp(&horizon, (y / 0.26 + 0.2 * ripple).clamp(0.0, 1.0));
            mirrored * (0.75 + 0.15 * ripple)
        } else {
            let grass = noise(x * 2.0, y, 11, 0.05, 5);
            let green = srgb(0x5d8a32).lerp(&srgb(0xb7a944), 0.5 + 0.5 * grass.clamp(-1.0, 1.0));
            let flower = unit((x * 70.0) as i32, (y * 90.0) as i32, seed ^ 0x77) > 0.93;
            if flower {
                srgb(0xd9483b)
            } else {
                green * (0.6 + 1.5 * y)
            }
        };
    }
    let sky = horizon.lerp(&zenith, ((y - 0.45) * 1.8).clamp(0.0, 1.0));
    let sun = [0.3 + 0.9 * unit(2, 0, seed), 0.68 + 0.15 * unit(3, 0, seed)];
    let glow = (-14.0 * (x - sun[0]).hypot(y - sun[1])).exp();
    let cloud = (1.8 * noise(x, 2.5 * y, 12, 0.7, 6) - 0.1).clamp(0.0, 0.85);
    sky.lerp(&Rgb::repeat(0.92), cloud)
        .lerp(&srgb(0xfff2c4), glow)
}

fn hash_bit(seed: u32) -> bool {
    unit(4, 0, seed) < 0.5
}

/// Whether a fir tree covers the point at `x`, `above` the line of a ridge.
fn fir(x: f32, above: f32, seed: u32) -> bool {
    const SPACING: f32 = 0.035;
    let i = (x / SPACING).floor();
    let tall = 0.14 * unit(i as i32, 5, seed) - 0.03;
    let middle = (i + 0.3 + 0.4 * unit(i as i32, 6, seed)) * SPACING;
    let share = above / tall.max(1e-3);
    // Branches in tiers.
    let reach = 0.3 * tall * (1.0 - share) * (0.7 + 0.3 * (share * 6.0).rem_euclid(1.0));
    (-0.5..1.0).contains(&share) && (x - middle).abs() < reach
}

/// Overlapping discs, rings and bars in strong colours.
pub(crate) fn abstract_painting(spot: &Spot) -> Rgb {
    const PALETTE: [u32; 7] = [
        0xd1495b, 0xedae49, 0x00798c, 0x30638e, 0x003d5b, 0xf4f1de, 0x81b29a,
    ];
    let height = spot.size[1];
    let (x, y) = (spot.u / height, spot.v / height);
    let wide = spot.size[0] / height;
    let mut color = srgb(0xefe6d2);
    for i in 0..14 {
        let random = |k| unit(i, k, spot.seed);
        let (dx, dy) = (x - wide * random(0), y - random(1));
        let radius = 0.06 + 0.22 * random(2);
        let inside = match (random(3) * 3.0) as u32 {
            0 => dx.hypot(dy) < radius,
            1 => (dx.hypot(dy) - radius).abs() < 0.025,
            _ => {
                let (sin, cos) = (PI * random(4)).sin_cos();
                (dx * cos + dy * sin).abs() < 0.03 && (dy * cos - dx * sin).abs() < 2.0 * radius
            }
        };
        if inside {
            color = srgb(PALETTE[(random(5) * PALETTE.len() as f32) as usize]);
        }
    }
    // Brush strokes.
    color * (1.0 + 0.12 * fbm([x * 0.25, y], spot.seed, 0.03, 3, spot.footprint / height))
}

/// Many flowers on a dark background.
pub(crate) fn blossoms(spot: &Spot) -> Rgb {
    const PALETTE: [u32; 5] = [0xe76f7a, 0xf2d0a4, 0xe8e6e1, 0xc94f7c, 0xf0b429];
    let height = spot.size[1];
    let (x, y) = (6.0 * spot.u / height, 6.0 * spot.v / height);
    let leaves = fbm([x, y], spot.seed, 0.6, 4, 6.0 * spot.footprint / height);
    let mut color = srgb(0x24402c) * (1.0 + 0.7 * leaves).max(0.2);
    let (i, j) = (x.floor() as i32, y.floor() as i32);
    for dj in -1..=1 {
        for di in -1..=1 {
            let (i, j) = (i + di, j + dj);
            let random = |k: u32| unit(i, j, spot.seed ^ (k * 0x51));
            let dx = x - i as f32 - random(1);
            let dy = y - j as f32 - random(2);
            let (radius, angle) = (dx.hypot(dy), dy.atan2(dx));
            let reach = 0.35 + 0.3 * random(3);
            let petals = (3.0 + (3.0 * random(4)).floor()) * angle + 6.0 * random(5);
            if radius < 0.2 * reach {
                return srgb(0x6b3f12);
            }
            if radius < reach * (0.75 + 0.25 * petals.cos()) {
                let petal = srgb(PALETTE[(random(6) * PALETTE.len() as f32) as usize]);
                color = petal * (0.45 + 0.55 * radius / reach);
            }
        }
    }
    color
}

/// Land and sea with a grid of parallels and meridians.
pub(crate) fn globe(spot: &Spot) -> Rgb {
    let [around, height] = spot.size;
    let (x, y) = (spot.u / around, spot.v / height);
    let land = fbm(
        [4.0 * x, 2.0 * y],
        spot.seed,
        0.9,
        5,
        4.0 * spot.footprint / around,
    );
    let line = (y * 12.0).rem_euclid(1.0) < 0.05 || (x * 24.0).rem_euclid(1.0) < 0.05;
    if line {
        srgb(0x40566b)
    } else if land > 0.05 {
        srgb(0x9a8c54).lerp(&srgb(0x4f7a3f), (3.0 * land).clamp(0.0, 1.0))
    } else {
        srgb(0x7fb0cf)
    }
}
