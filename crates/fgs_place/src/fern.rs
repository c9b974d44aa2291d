//! A fern: four questions about the surroundings of one cell, and the code of their answers.

use std::sync::LazyLock;

use fgs_geom::Image;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::small_image::{Cell, HEIGHT, WIDTH};

/// Number of ferns. Half as many miss some places, twice as many find hardly more.
pub const FERNS: usize = 256;

/// The answers to the three questions about colour, one bit each.
const COLOR: u8 = 0b111;
/// Whether the cell lies behind the fern's distance.
const IS_FAR: u8 = 0b1000;
/// Whether the image has depth there.
const HAS_DEPTH: u8 = IS_FAR << 1;
/// Whether the image shows the fern's cells, and contrast between them.
const IS_SEEN: u8 = HAS_DEPTH << 1;

/// The answers of one fern about one image. 0 if it sees nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Code(u8);

/// The codes of all ferns.
pub type Codes = [Code; FERNS];

/// Compares the colours of a cell with those of cells close by: two objects apart move against each
/// other when the camera moves, what is close stays together.
struct Fern {
    cell: [i32; 2],
    /// Where the cells are with which brightness, red-blue and green-magenta are compared, relative
    /// to `cell`.
    partners: [[i32; 2]; 3],
    /// Distance with which the cell's depth is compared, metres.
    depth_m: f64,
}

/// Always the same ferns: descriptors can be compared across runs.
static ALL: LazyLock<Vec<Fern>> = LazyLock::new(|| {
    let mut rng = Pcg64Mcg::seed_from_u64(2015);
    (0..FERNS).map(|_| Fern::random(&mut rng)).collect()
});

/// The codes of `image` moved left and up by `shift` cells.
pub fn codes(image: &Image<Cell>, shift: [i32; 2]) -> Codes {
    let mut codes = [Code::default(); FERNS];
    for (code, fern) in codes.iter_mut().zip(&*ALL) {
        *code = fern.code(image, shift).unwrap_or_default();
    }
    codes
}

impl Fern {
    fn random(rng: &mut Pcg64Mcg) -> Self {
        /// Distance to a partner along one axis, cells.
        const REACH: i32 = 3;
        /// Depths that tell indoor places apart, metres.
        const DEPTHS_M: [f64; 2] = [0.6, 5.0];
        let inside =
            |[u, v]: [i32; 2]| (0..WIDTH as i32).contains(&u) && (0..HEIGHT as i32).contains(&v);
        let cell = [
            rng.random_range(0..WIDTH as i32),
            rng.random_range(0..HEIGHT as i32),
        ];
        let partners = std::array::from_fn(|_| {
            loop {
                let [du, dv] = std::array::from_fn(|_| rng.random_range(-REACH..=REACH));
                if [du, dv] != [0, 0] && inside([cell[0] + du, cell[1] + dv]) {
                    return [du, dv];
                }
            }
        });
        let [near, far] = DEPTHS_M.map(f64::ln);
        Self {
            cell,
            partners,
            depth_m: rng.random_range(near..far).exp(),
        }
    }

    /// `None` if a cell is outside the image or has no colour, or a partner has the same colour:
    /// what is black or white throughout is no sign of a place.
    fn code(&self, image: &Image<Cell>, shift: [i32; 2]) -> Option<Code> {
        /// Smallest contrast that is no rounding error, 8-bit steps.
        const MIN_CONTRAST: f64 = 0.1;
        let at = |[du, dv]: [i32; 2]| {
            let u = usize::try_from(self.cell[0] + shift[0] + du).ok()?;
            image.get(u, usize::try_from(self.cell[1] + shift[1] + dv).ok()?)
        };
        let cell = at([0, 0])?;
        let color = cell.color?;
        let mut code = IS_SEEN;
        for (channel, partner) in self.partners.iter().enumerate() {
            let difference = color[channel] - at(*partner)?.color?[channel];
            if difference.abs() < MIN_CONTRAST {
                return None;
            }
            code |= u8::from(difference > 0.0) << channel;
        }
        if let Some(depth_m) = cell.depth_m {
            code |= HAS_DEPTH | if depth_m > self.depth_m { IS_FAR } else { 0 };
        }
        Some(Code(code))
    }
}

/// How similar two images are by their codes: 1 if all ferns agree, 0 if no more than in unrelated
/// images. Symmetric.
pub fn similarity(a: &Codes, b: &Codes) -> f64 {
    /// Share of ferns that agree on colour in unrelated images, and on colour and depth.
    const CHANCE_BY_COLOR: f64 = 0.33;
    const CHANCE: f64 = 0.2;
    let Agreement { agree, seen, deep } = Agreement::of(a, b);
    let by_color = seen - deep;
    let chance = CHANCE_BY_COLOR * by_color + CHANCE * deep;
    ((agree - chance) / (FERNS as f64 - chance)).max(0.0)
}

/// Numbers of ferns.
struct Agreement {
    /// With the same answers, as far as both images have them.
    agree: f64,
    /// Seen by both.
    seen: f64,
    /// Seen by both with depth.
    deep: f64,
}

impl Agreement {
    fn of(a: &Codes, b: &Codes) -> Self {
        /// Few enough to be counted in a byte: a processor counts in many bytes at once.
        const CHUNK: usize = 128;
        let [mut agree, mut seen, mut deep] = [0.0; 3];
        for (a, b) in a.chunks(CHUNK).zip(b.chunks(CHUNK)) {
            let mut counts = [0_u8; 3];
            for (Code(a), Code(b)) in a.iter().zip(b) {
                let both = a & b;
                let seen = u8::from(both & IS_SEEN != 0);
                let asked = COLOR | (both & HAS_DEPTH) >> 1;
                counts[0] += seen & u8::from((a ^ b) & asked == 0);
                counts[1] += seen;
                counts[2] += seen & u8::from(both & HAS_DEPTH != 0);
            }
            agree += f64::from(counts[0]);
            seen += f64::from(counts[1]);
            deep += f64::from(counts[2]);
        }
        Self { agree, seen, deep }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Another release of the random generator would make others.
    #[test]
    fn the_ferns_are_always_the_same() {
        let place = |[u, v]: [i32; 2]| u + 20 * v;
        let sum: i32 = (ALL.iter().zip(1..))
            .map(|(fern, i)| i * (place(fern.cell) + fern.partners.map(place).iter().sum::<i32>()))
            .sum();
        let depth_m: f64 = ALL.iter().map(|fern| fern.depth_m).sum();
        assert_eq!((sum, (1e6 * depth_m).round()), (5_194_198, 537_863_386.0));
    }
}
