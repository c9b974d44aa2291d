//! How well the colours of registered frames agree: a second witness, besides depth, of whether the
//! camera is right.

use fgs_geom::{Camera, Image, Se3};

use super::frame_pairs::FramePair;
use super::self_calibration::samples;
use super::statistics::median;

/// How far the colours of two frames disagree where both see the same points: the median absolute
/// difference of brightness over all pairs, after equalising the frames' mean levels. `None` if no
/// pair has a point in common.
pub fn color_misfit(
    pairs: &[FramePair],
    first_from_second: &[Se3],
    given: &Camera,
    camera: &Camera,
) -> Option<f64> {
    let of_pair = |(pair, motion): (&FramePair, &Se3)| {
        let differences: Vec<f64> = samples(pair, given)
            .iter()
            .filter_map(|sample| {
                let point = camera.unproject(sample.u, sample.v, sample.depth_m);
                let pixel = camera.project(&motion.transform(&point))?;
                let there = local_mean(&pair.first.luma, pixel.x.round(), pixel.y.round())?;
                Some(there - local_mean(&pair.second.luma, sample.u, sample.v)?)
            })
            .collect();
        let level = median(differences.clone())?;
        median(
            differences
                .iter()
                .map(|difference| (difference - level).abs())
                .collect(),
        )
    };
    median(
        pairs
            .iter()
            .zip(first_from_second)
            .filter_map(of_pair)
            .collect(),
    )
}

/// The mean over 5x5 pixels, which evens out noise and differences in sharpness.
fn local_mean(luma: &Image<f32>, u: f64, v: f64) -> Option<f64> {
    if !(u >= 2.0 && v >= 2.0 && u + 2.0 < luma.width() as f64 && v + 2.0 < luma.height() as f64) {
        return None;
    }
    let (u, v) = (u as usize, v as usize);
    let rows = (v - 2..=v + 2).flat_map(|row| &luma.row(row)[u - 2..=u + 2]);
    Some(rows.map(|value| f64::from(*value)).sum::<f64>() / 25.0)
}
