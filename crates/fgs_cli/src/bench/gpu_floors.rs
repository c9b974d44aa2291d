//! The least that each stage of an optimisation step moves and computes on a graphics device.
//!
//! Counted from the shaders (fgs_splat/src/gpu/shaders) and the structures in `layout.rs` beside them.
//! Bytes: every array that a stage uses, read once and written once, whatever its caches hold. Of
//! rows that a stage uses in part all is counted, as neighbours need the rest. Operations: those
//! on floats, a multiply-add counting two and all others one.
//!
//! All counts are from below: a tile's entries are evaluated at its 64 pixels, but none of them is
//! taken (blending and its derivative are left out); what workgroups compute twice at their borders
//! counts once. They hold as long as each gaussian in view is touched and no pixel is saturated, as
//! in the scenes here; else a stage may have less to do.

use fgs_splat::Rates;

/// A card to compare with, of round numbers.
pub const NOMINAL: Rates = Rates {
    bytes_per_sec: 4e12,
    flops_per_sec: 60e12,
};

/// What a step goes over.
#[derive(Clone, Copy)]
pub struct Work {
    pub gaussians: usize,
    pub in_view: usize,
    /// Of the tiles' lists.
    pub entries: usize,
    pub pixels: usize,
}

/// Bytes and operations by gaussian, gaussian in view, entry and pixel.
type Cost = ([f64; 4], [f64; 4]);

/// A gaussian, splat, gradient or sum over an entry's pixels, and each of the two moments of Adam.
const ROW: f64 = 64.0;
/// Sorted keys and values of 4 bytes: eight bits a pass, so four passes by depth, and two by tile up
/// to 65 536 tiles. A block of 2048 keys has 256 counts, 0.5 bytes a key.
const BY_DEPTH: f64 = 4.0;
const BY_TILE: f64 = 2.0;
/// A word for each workgroup of 256.
const BLOCK: f64 = 4.0 / 256.0;
/// Where a tile's list lies: 8 bytes for 64 pixels.
const RANGE: f64 = 8.0 / 64.0;
/// A bit of a set.
const BIT: f64 = 1.0 / 8.0;
/// `is_in_view` before `projection`; then that, `splat_of` and `support_of`; `touched_columns`, once.
const CULL_FLOPS: f64 = 40.0;
const PROJECTION_FLOPS: f64 = 220.0;
const SPLAT_FLOPS: f64 = 30.0;
const SUPPORT_FLOPS: f64 = 20.0;
const COLUMNS_FLOPS: f64 = 50.0;
/// `sample_of` and the comparison of its alpha, at the 64 pixels of a tile.
const EVALUATION_FLOPS: f64 = 64.0 * 19.0;
/// A value weighted by eleven taps along each axis.
const BLUR_FLOPS: f64 = 2.0 * 22.0;

fn cost(stage: &str) -> Option<Cost> {
    let drawn = PROJECTION_FLOPS + SPLAT_FLOPS + SUPPORT_FLOPS;
    Some(match stage {
        // Gaussians; the view's set, cleared.
        "count_in_view" => ([ROW + BIT + BLOCK, 0., 0., 0.], [CULL_FLOPS, drawn, 0., 0.]),
        "place_in_view" => ([2. * BLOCK, 0., 0., 0.], [0.; 4]),
        // Gaussians; splats, their gaussians, depth keys, order, and touches of 8 bytes.
        "project" => (
            [ROW + BLOCK, ROW + 20., 0., 0.],
            [CULL_FLOPS, drawn + COLUMNS_FLOPS, 0., 0.],
        ),
        // Keys; counts.
        "count_digits" => ([0., BY_DEPTH * 4.5, BY_TILE * 4.5, 0.], [0.; 4]),
        // Counts, twice.
        "place_digits" => ([0., BY_DEPTH, BY_TILE, 0.], [0.; 4]),
        // Keys and values, twice; counts.
        "move_keys" => ([0., BY_DEPTH * 16.5, BY_TILE * 16.5, 0.], [0.; 4]),
        // Order, touches.
        "count_touches" => ([0., 12. + BLOCK, 0., 0.], [0.; 4]),
        "place_touches" => ([0., 2. * BLOCK, 0., 0.], [0.; 4]),
        // Order, touches twice, half a splat; tile, slot and splat of each entry.
        "write_touches" => (
            [0., 20. + ROW / 2. + BLOCK, 12., 0.],
            [0., SUPPORT_FLOPS + COLUMNS_FLOPS, 0., 0.],
        ),
        // The keys on both sides of each tile's first.
        "find_ranges" => ([0., 0., 0., 2. * RANGE], [0.; 4]),
        // Splats; slots and their splats; image and state of 8 bytes.
        "forward" => ([0., ROW, 8., RANGE + 24.], [0., 0., EVALUATION_FLOPS, 0.]),
        // Target of 8 bytes and image; nine moments. Of each channel four blurs, the squares, the
        // formula.
        "ssim" => (
            [0., 0., 0., 60. + BLOCK],
            [0., 0., 0., 3. * (4. * BLUR_FLOPS + 22. + 45.)],
        ),
        // Target, image, moments, state; cotangents of 20 bytes. Of each channel three blurs.
        "losses" => (
            [0., 0., 0., 88. + 2. * BLOCK],
            [0., 0., 0., 3. * (3. * BLUR_FLOPS + 12.) + 12.],
        ),
        // Splats; slots, their splats and sums; state and cotangents. Each pixel's weight is looked
        // at once more, and sixteen sums are added from four.
        "backward" => (
            [0., ROW, 8. + ROW, RANGE + 28.],
            [0., 0., EVALUATION_FLOPS + 64. + 64., 0.],
        ),
        // The set's bits, twice; touches, gaussian's number, gaussian, gradient; sums.
        "project_vjp" => (
            [2. * BIT, 12. + 2. * ROW, ROW, 0.],
            [0., PROJECTION_FLOPS + 300., 16., 0.],
        ),
        // Number, gradient; gaussian and moments, twice. Fifteen operations a parameter as on the
        // CPU, the regulariser.
        "adam" => (
            [0., 4. + ROW + 6. * ROW + BLOCK, 0., 0.],
            [0., 15. * 14. + 40., 0., 0.],
        ),
        "step_stats" => ([0., BLOCK, 0., 3. * BLOCK], [0.; 4]),
        _ => return None,
    })
}

/// The least milliseconds that a stage takes in a step: to move its bytes or to do its operations,
/// whichever is longer. `None` if the stage is not known.
pub fn floor_ms(stage: &str, work: &Work, rates: &Rates) -> Option<f64> {
    let (bytes, flops) = cost(stage)?;
    let numbers = [work.gaussians, work.in_view, work.entries, work.pixels];
    let total = |by: [f64; 4]| -> f64 {
        let products = by.iter().zip(numbers);
        products.map(|(each, number)| each * number as f64).sum()
    };
    let secs = (total(bytes) / rates.bytes_per_sec).max(total(flops) / rates.flops_per_sec);
    Some(1e3 * secs)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longer_of_moving_and_computing_counts() {
        let work = Work {
            gaussians: 0,
            in_view: 1_000_000,
            entries: 3_000_000,
            pixels: 0,
        };
        let floor = |bytes_per_sec, flops_per_sec| {
            let rates = Rates {
                bytes_per_sec,
                flops_per_sec,
            };
            floor_ms("forward", &work, &rates).unwrap()
        };
        // 64 MB of splats and 24 MB of slots; 64 times 19 operations an entry.
        assert!((floor(88e9, 1e18) - 1.0).abs() < 1e-9);
        assert!((floor(1e18, 3.648e12) - 1.0).abs() < 1e-9);
        assert_eq!(floor_ms("lunch", &work, &NOMINAL), None);
    }
}
