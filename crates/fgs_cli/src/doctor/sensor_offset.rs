//! How depth lies to colour, to a fraction of a pixel: a small turn and shift between the two sensors.
//!
//! A turn moves all depth edges alike in the image, a shift moves near ones more than far ones. Input: for
//! some frames, how well the edges of near and of far things agree with colour edges at each shift in
//! the image. Output: turn and shift about the image's axes, with errors from the scatter between
//! groups of frames.

use fgs_geom::Camera;

/// Groups of frames whose scatter gives the errors.
const GROUPS: usize = 6;

/// Offsets are searched up to so many pixels of the working image; larger ones are another check's.
const MAX_PX: usize = 3;

/// Agreement at each shift for the edges of things of about one depth, in one frame.
#[derive(Clone)]
pub struct EdgesAtDepth {
    /// Square, row by row, shifts ascending.
    pub scores: Vec<f32>,
    /// How far, in columns and rows, edges lie behind the pixels that they were looked up at, on
    /// average: the offset that is found where there is none.
    pub lag: [f64; 2],
    /// Mean inverse depth of the edges, 1/m.
    pub inverse_depth: f64,
}

/// A turn and a shift between depth and colour, along columns and rows.
#[derive(Clone, Copy, Debug)]
pub struct SensorOffset {
    /// By how much depth has to be moved to lie on colour, pixels of the recording, on average.
    pub image_px: [f64; 2],
    /// By how much depth has to be moved to lie on colour at infinity, pixels of the recording.
    pub turn_px: [f64; 2],
    /// How far right and below the colour camera the depth is measured as if it were, metres.
    pub shift_m: [f64; 2],
}

/// The offset and its standard errors; `None` if there are too few frames, or the edges do not tell.
/// `reduction` is in pixels of the recording per pixel of the working image.
pub fn sensor_offset(
    frames: &[[EdgesAtDepth; 2]],
    camera: &Camera,
    reduction: usize,
) -> Option<[SensorOffset; 2]> {
    let px = reduction as f64;
    let focal_px = [camera.intrinsics.fx, camera.intrinsics.fy];
    let offset = |frames: &[[EdgesAtDepth; 2]]| {
        let parts = [0, 1].map(|part| mean(frames.iter().map(|frame| &frame[part])));
        let [near, far] = &parts;
        let (near_px, far_px) = (peak(near.as_ref()?)?, peak(far.as_ref()?)?);
        let [near_q, far_q] =
            [near, far].map(|part| part.as_ref().map_or(0.0, |p| p.inverse_depth));
        let slope = |axis: usize| px * (near_px[axis] - far_px[axis]) / (near_q - far_q);
        Some(SensorOffset {
            image_px: [0, 1].map(|axis| 0.5 * px * (near_px[axis] + far_px[axis])),
            turn_px: [0, 1].map(|axis| px * far_px[axis] - slope(axis) * far_q),
            shift_m: [0, 1].map(|axis| slope(axis) / focal_px[axis]),
        })
    };
    let len = frames.len();
    let group = |i: usize| offset(&frames[i * len / GROUPS..(i + 1) * len / GROUPS]);
    let groups: Vec<SensorOffset> = (0..GROUPS).map(group).collect::<Option<_>>()?;
    let found = offset(frames)?;
    let error = |value: &dyn Fn(&SensorOffset) -> f64| {
        let squares = groups
            .iter()
            .map(|group| (value(group) - value(&found)).powi(2));
        (squares.sum::<f64>() / (GROUPS * (GROUPS - 1)) as f64).sqrt()
    };
    let errors = SensorOffset {
        image_px: [0, 1].map(|axis| error(&|offset| offset.image_px[axis])),
        turn_px: [0, 1].map(|axis| error(&|offset| offset.turn_px[axis])),
        shift_m: [0, 1].map(|axis| error(&|offset| offset.shift_m[axis])),
    };
    Some([found, errors])
}

fn mean<'a>(edges: impl Iterator<Item = &'a EdgesAtDepth>) -> Option<EdgesAtDepth> {
    let mut edges = edges;
    let mut sum = edges.next()?.clone();
    let mut count = 1.0;
    for other in edges {
        sum.scores
            .iter_mut()
            .zip(&other.scores)
            .for_each(|(sum, score)| *sum += score);
        for axis in 0..2 {
            sum.lag[axis] += other.lag[axis];
        }
        sum.inverse_depth += other.inverse_depth;
        count += 1.0;
    }
    // Only where the scores are highest matters, not how high they are.
    sum.lag = sum.lag.map(|lag| lag / count);
    sum.inverse_depth /= count;
    Some(sum)
}

/// Where the agreement is best, columns and rows of the working image, by a parabola through the best
/// shift and its neighbours.
fn peak(edges: &EdgesAtDepth) -> Option<[f64; 2]> {
    let side = edges.scores.len().isqrt();
    let middle = side / 2;
    let near = middle - MAX_PX..=middle + MAX_PX;
    let at = |u: usize, v: usize| f64::from(edges.scores[v * side + u]);
    let places = near.clone().flat_map(|v| near.clone().map(move |u| (u, v)));
    let (u, v) = places.max_by(|a, b| at(a.0, a.1).total_cmp(&at(b.0, b.1)))?;
    let fit = |before: f64, here: f64, after: f64| {
        let bend = before - 2.0 * here + after;
        (bend < 0.0).then(|| 0.5 * (before - after) / bend)
    };
    let along_u = fit(at(u - 1, v), at(u, v), at(u + 1, v))?;
    let along_v = fit(at(u, v - 1), at(u, v), at(u, v + 1))?;
    let from_middle = |place: usize| place as f64 - middle as f64;
    Some([
        from_middle(u) + along_u - edges.lag[0],
        from_middle(v) + along_v - edges.lag[1],
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::test_room;

    /// Edges that agree best at a shift, in columns and rows.
    fn edges(best: [f64; 2], inverse_depth: f64) -> EdgesAtDepth {
        let distance = |i: usize| {
            let shift = |place: usize| place as f64 - 12.0;
            (shift(i % 25) - best[0]).powi(2) + (shift(i / 25) - best[1]).powi(2)
        };
        EdgesAtDepth {
            scores: (0..625)
                .map(|i| (1.0 - 0.01 * distance(i)) as f32)
                .collect(),
            lag: [0.0; 2],
            inverse_depth,
        }
    }

    #[test]
    fn a_turn_moves_all_edges_and_a_shift_moves_near_ones_more() {
        let camera = test_room::camera();
        // 1 px to the left and, at 1 m, 18 px = 0.1 m / 1 m further to the right.
        let at = |inverse_depth: f64| edges([-1.0 + 1.8 * inverse_depth, 0.5], inverse_depth);
        let frames: Vec<_> = (0..12).map(|_| [at(1.0), at(0.25)]).collect();
        let [found, errors] = sensor_offset(&frames, &camera, 2).unwrap();
        assert!((found.turn_px[0] + 2.0).abs() <= 1e-3, "{found:?}");
        assert!((found.turn_px[1] - 1.0).abs() <= 1e-3, "{found:?}");
        // 1.8 (1 + 0.25) / 2 - 1 pixels of the working image.
        assert!((found.image_px[0] - 0.25).abs() <= 1e-3, "{found:?}");
        assert!((found.shift_m[0] - 0.02).abs() <= 1e-4, "{found:?}");
        assert!(found.shift_m[1].abs() <= 1e-4, "{found:?}");
        assert!(errors.turn_px[0] <= 1e-3 && errors.shift_m[0] <= 1e-4);
        assert!(sensor_offset(&frames[..5], &camera, 2).is_none());
    }
}
