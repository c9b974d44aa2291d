//! The rigid motion between two cameras that most matches agree on.
//!
//! RANSAC (Fischler and Bolles 1981) over triples of matches with depth, local optimisation of each
//! new best (Chum, Matas and Kittler 2003), truncated squared errors as score (Torr and Zisserman
//! 2000).

use fgs_geom::{Camera, Se3, rigid_alignment};
use nalgebra::{Matrix6, Vector2, Vector3};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::agreement::{MAX_SQUARED_ERROR, Motion, NormalEquations, Pair, depth_noise_m};
use crate::{Features, Match};

/// Fewer matches that agree prove nothing. Of 2600 pairs of real frames that show different places
/// none had more than 6.
const MIN_INLIERS: usize = 10;

/// A position less certain than this, metres of standard deviation, is no answer: the inliers lie
/// too near each other. On real pairs this takes away two in three of the answers that are off by
/// more than 10 cm or 5 degrees, for one good answer in ninety.
const MAX_DEVIATION_M: f64 = 0.03;

/// Triples drawn at most. Most have sides of different lengths in the two frames, which costs
/// little.
const MAX_TRIPLES: usize = 50_000;

/// Motions scored at most.
const MAX_MOTIONS: usize = 1000;

/// The chance with which no triple of inliers alone may have been drawn.
const MISS_CHANCE: f64 = 1e-3;

/// Triples drawn at least, however many matches agree with one of them.
const MIN_TRIPLES: usize = 100;

/// Steps of least squares for each new best motion, and for the last.
const LOCAL_STEPS: usize = 4;
const LAST_STEPS: usize = 10;

/// Twice a triangle's area over its squared depth: thinner ones do not determine a rotation.
const MIN_SPAN: f64 = 0.01;

/// A relative pose and what speaks for it.
#[derive(Clone, Debug, PartialEq)]
pub struct RelativePose {
    /// Maps the second camera's axes to the first's.
    pub a_from_b: Se3,
    /// The number of matches that agree with it.
    pub inliers: usize,
    /// Their share of all matches that have depth in a frame, 0 to 1.
    pub share: f64,
    /// The share of 8x6 parts of the image in which there are inliers, in the frame where it is
    /// less.
    pub coverage: f64,
    /// Information matrix for perturbations from the right, `[omega, v]` (rad, metres), if the
    /// inliers' errors are independent.
    pub information: Matrix6<f64>,
}

/// The pose of the camera of `b` relative to that of `a`. `None` if fewer than 10 matches agree on
/// one, or if they leave its position uncertain by more than 3 cm. Matches of features that do not
/// exist count for nothing. The same `seed` gives the same result.
pub fn relative_pose(
    a: &Features,
    b: &Features,
    matches: &[Match],
    seed: u64,
) -> Option<RelativePose> {
    let pair = |of: &Match| {
        let (a_feature, b_feature) = (a.all.get(of.a)?, b.all.get(of.b)?);
        (a_feature.point.is_some() || b_feature.point.is_some()).then_some(Pair {
            a: a_feature,
            b: b_feature,
            cameras: [&a.camera, &b.camera],
        })
    };
    let pairs: Vec<Pair> = matches.iter().filter_map(pair).collect();
    let a_from_b = search(&pairs, &mut Pcg64Mcg::seed_from_u64(seed))?;
    let motion = Motion::new(&a_from_b);
    let mut inliers = pairs.iter().collect::<Vec<_>>();
    inliers.retain(|pair| pair.squared_error(&motion) < MAX_SQUARED_ERROR);
    let mut equations = NormalEquations::zero();
    for pair in &inliers {
        pair.linearize(&motion, 1.0, &mut equations);
    }
    let covariance = equations.hessian.try_inverse()?;
    let of_position = covariance.fixed_view::<3, 3>(3, 3).into_owned();
    let deviation_m = of_position.symmetric_eigenvalues().max().sqrt();
    // Written so that NaN is refused too.
    let is_certain = inliers.len() >= MIN_INLIERS && deviation_m <= MAX_DEVIATION_M;
    let coverage_a = coverage(&a.camera, inliers.iter().map(|pair| pair.a.pixel));
    let coverage_b = coverage(&b.camera, inliers.iter().map(|pair| pair.b.pixel));
    is_certain.then_some(RelativePose {
        a_from_b,
        inliers: inliers.len(),
        share: inliers.len() as f64 / pairs.len() as f64,
        coverage: coverage_a.min(coverage_b),
        information: equations.hessian,
    })
}

/// The share of 8x6 parts of the image in which there is a pixel.
fn coverage(camera: &Camera, pixels: impl Iterator<Item = Vector2<f64>>) -> f64 {
    let mut is_touched = [false; 48];
    for pixel in pixels {
        let part = |at: f64, size: usize, count: f64| {
            (count * (at + 0.5) / size as f64).clamp(0.0, count - 1.0) as usize
        };
        let row = part(pixel.y, camera.height, 6.0);
        is_touched[8 * row + part(pixel.x, camera.width, 8.0)] = true;
    }
    is_touched.iter().filter(|touched| **touched).count() as f64 / 48.0
}

/// The motion that most pairs agree on, of those that triples of pairs give.
fn search(pairs: &[Pair], rng: &mut impl Rng) -> Option<Se3> {
    let with_points: Vec<[Vector3<f64>; 2]> = pairs
        .iter()
        .filter_map(|pair| Some([pair.a.point?, pair.b.point?]))
        .collect();
    if with_points.len() < 3 {
        return None;
    }
    let mut best: Option<(f64, Se3)> = None;
    let (mut triples, mut motions, mut needed) = (0, 0, MAX_TRIPLES);
    while triples < needed && motions < MAX_MOTIONS {
        triples += 1;
        let triple = three_of(with_points.len(), rng).map(|i| &with_points[i]);
        if !is_rigid(triple) {
            continue;
        }
        let Some(motion) = rigid_alignment(&triple.map(|[a, _]| *a), &triple.map(|[_, b]| *b))
        else {
            continue;
        };
        motions += 1;
        let least = best.map_or(0.0, |(score, _)| score);
        let first_score = score(pairs, &motion, least);
        if first_score <= least {
            continue;
        }
        let (score, motion) = refined(pairs, (first_score, motion), LOCAL_STEPS);
        best = Some((score, motion));
        // An inlier scores less than 1, so this underestimates their share.
        let share = (score / pairs.len() as f64).min(0.99);
        let draws = MISS_CHANCE.ln() / (1.0 - share.powi(3)).ln();
        needed = (draws as usize).clamp(MIN_TRIPLES, needed);
    }
    best.map(|best| refined(pairs, best, LAST_STEPS).1)
}

/// Three different indices below `count`, which is at least 3.
fn three_of(count: usize, rng: &mut impl Rng) -> [usize; 3] {
    loop {
        let [i, j, k] = std::array::from_fn(|_| rng.random_range(0..count));
        if i != j && j != k && k != i {
            return [i, j, k];
        }
    }
}

/// Whether three points span a triangle, of the same sides in both frames as far as depth can tell.
fn is_rigid(triple: [&[Vector3<f64>; 2]; 3]) -> bool {
    let [p, q, r] = triple;
    let has_one_length = |s: &[Vector3<f64>; 2], t: &[Vector3<f64>; 2]| {
        let [in_a, in_b] = [0, 1].map(|frame| (s[frame] - t[frame]).norm());
        let variances = [s[0], s[1], t[0], t[1]].map(|point| depth_noise_m(point.z).powi(2));
        (in_a - in_b).powi(2) <= MAX_SQUARED_ERROR * variances.into_iter().sum::<f64>()
    };
    let doubled_area = (q[0] - p[0]).cross(&(r[0] - p[0])).norm();
    doubled_area > MIN_SPAN * p[0].z * p[0].z
        && has_one_length(p, q)
        && has_one_length(q, r)
        && has_one_length(r, p)
}

/// How many pairs agree, each counted by how well. 0 where more than `least` is out of reach.
fn score(pairs: &[Pair], a_from_b: &Se3, least: f64) -> f64 {
    let motion = Motion::new(a_from_b);
    let mut score = 0.0;
    for (i, pair) in pairs.iter().enumerate() {
        if score + (pairs.len() - i) as f64 <= least {
            return 0.0;
        }
        score += agreement(pair, &motion);
    }
    score
}

/// 1 for a pair without error, 0 for an outlier.
fn agreement(pair: &Pair, motion: &Motion) -> f64 {
    (1.0 - pair.squared_error(motion) / MAX_SQUARED_ERROR).max(0.0)
}

/// A motion after steps of least squares with Tukey's weights, and its score; what was given if
/// that is better.
fn refined(pairs: &[Pair], given: (f64, Se3), steps: usize) -> (f64, Se3) {
    let mut a_from_b = given.1;
    for _ in 0..steps {
        let motion = Motion::new(&a_from_b);
        let mut equations = NormalEquations::zero();
        for pair in pairs {
            let weight = agreement(pair, &motion).powi(2);
            if weight > 0.0 {
                pair.linearize(&motion, weight, &mut equations);
            }
        }
        let Some(factor) = equations.hessian.cholesky() else {
            return given;
        };
        let step = -factor.solve(&equations.gradient);
        if !step.iter().all(|value| value.is_finite()) {
            return given;
        }
        a_from_b = (a_from_b * Se3::exp(&step)).renormalized();
    }
    let score = score(pairs, &a_from_b, given.0);
    if score > given.0 {
        (score, a_from_b)
    } else {
        given
    }
}
