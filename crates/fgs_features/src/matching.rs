//! Pairs of features of two frames that look alike.

use fgs_geom::{Kernel, dispatch};

use crate::{Descriptor, Feature, Features};

/// Descriptors that differ in more bits are not of one point.
const MAX_DISTANCE: u32 = 80;

/// The nearest descriptor's distance as a share of the second's, at most.
const MAX_RATIO: f64 = 0.95;

/// What lies within this many pixels, of the image that it was found in, is the same place.
const BESIDE_PX: f64 = 4.0;

/// A feature of each of two frames, by index, and how far their descriptors are apart, bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Match {
    /// Index of the first frame's feature.
    pub a: usize,
    /// Index of the second frame's feature.
    pub b: usize,
    /// Hamming distance of the descriptors.
    pub distance: u32,
}

/// The features that are each other's nearest and clearly nearer than what looks second most alike
/// elsewhere in the image of `b`, in the order of `a`.
pub fn match_features(a: &Features, b: &Features) -> Vec<Match> {
    if b.all.is_empty() {
        return Vec::new();
    }
    let descriptors: Vec<Descriptor> = b.all.iter().map(|feature| feature.descriptor).collect();
    let mut distances = vec![0; descriptors.len()];
    // For each feature of b the distance of the nearest of a, and below it that one's index.
    let mut nearest_to_b = vec![u64::MAX; descriptors.len()];
    let mut matches = Vec::new();
    for (i, feature) in a.all.iter().enumerate() {
        dispatch(Distances {
            index: i as u64,
            descriptor: &feature.descriptor,
            others: &descriptors,
            distances: &mut distances,
            nearest: &mut nearest_to_b,
        });
        let Some((j, distance)) = nearest(&distances) else {
            continue;
        };
        if distance <= MAX_DISTANCE && is_clear(&distances, &b.all, j) {
            matches.push(Match {
                a: i,
                b: j,
                distance,
            });
        }
    }
    matches.retain(|m| nearest_to_b[m.b] & INDEX == m.a as u64);
    matches
}

/// The bits of an index beside a distance: 9 are left for the distance.
const INDEX: u64 = u64::MAX >> 9;

/// The first of the least distances.
fn nearest(distances: &[u32]) -> Option<(usize, u32)> {
    let least = *distances.iter().min()?;
    let first = distances.iter().position(|distance| *distance == least)?;
    Some((first, least))
}

/// Whether everything but feature `j` and what lies beside it, which is found at other resolutions
/// too, is clearly farther.
fn is_clear(distances: &[u32], features: &[Feature], j: usize) -> bool {
    let limit = (f64::from(distances[j]) / MAX_RATIO) as u32;
    let (pixel, scale) = (features[j].pixel, features[j].scale);
    let is_elsewhere =
        |other: &Feature| (other.pixel - pixel).norm() > BESIDE_PX * other.scale.max(scale);
    let mut others = distances.iter().zip(features);
    others.all(|(distance, other)| *distance > limit || !is_elsewhere(other))
}

/// The distances of one descriptor from many, and for each of these the nearest one so far.
struct Distances<'a> {
    index: u64,
    descriptor: &'a Descriptor,
    others: &'a [Descriptor],
    distances: &'a mut [u32],
    nearest: &'a mut [u64],
}

impl Kernel for Distances<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool, const WIDTH: usize>(self) {
        for (distance, other) in self.distances.iter_mut().zip(self.others) {
            *distance = self.descriptor.distance(other);
        }
        for (nearest, distance) in self.nearest.iter_mut().zip(self.distances) {
            *nearest = (*nearest).min((u64::from(*distance) << 55) | self.index);
        }
    }
}

#[cfg(test)]
mod tests {
    use fgs_geom::{Camera, Intrinsics};
    use nalgebra::Vector2;

    use super::*;

    /// Features in a row, 20 pixels apart, with descriptors of so many bits from the first.
    fn features(bits: &[u32]) -> Features {
        let intrinsics = Intrinsics {
            fx: 500.0,
            fy: 500.0,
            cx: 320.0,
            cy: 240.0,
        };
        let feature = |(i, bits): (usize, &u32)| Feature {
            pixel: Vector2::new(20.0 * i as f64, 100.0),
            scale: 1.0,
            descriptor: Descriptor([0, 1, 2, 3].map(|word| {
                let set = bits.saturating_sub(64 * word).min(64);
                u64::MAX.checked_shr(64 - set).unwrap_or(0)
            })),
            point: None,
        };
        Features {
            camera: Camera::new(640, 480, intrinsics).unwrap(),
            all: bits.iter().enumerate().map(feature).collect(),
        }
    }

    fn pairs(a: &[u32], b: &[u32]) -> Vec<(usize, usize, u32)> {
        let matches = match_features(&features(a), &features(b));
        matches.iter().map(|m| (m.a, m.b, m.distance)).collect()
    }

    #[test]
    fn each_others_nearest_are_matched() {
        assert_eq!(
            pairs(&[0, 100, 200], &[205, 0, 90]),
            [(0, 1, 0), (1, 2, 10), (2, 0, 5)]
        );
        // The second feature of a is nearer to the only one of b.
        assert_eq!(pairs(&[0, 15], &[20]), [(1, 0, 5)]);
        assert_eq!(pairs(&[0], &[MAX_DISTANCE]), [(0, 0, MAX_DISTANCE)]);
        assert_eq!(pairs(&[0], &[MAX_DISTANCE + 1]), []);
        assert_eq!(pairs(&[], &[0]), []);
        assert_eq!(pairs(&[0], &[]), []);
    }

    #[test]
    fn what_looks_alike_elsewhere_is_ambiguous() {
        assert_eq!(pairs(&[100], &[60, 141]), []);
        assert_eq!(pairs(&[100], &[60, 150]), [(0, 0, 40)]);
        // Beside it, it is the same corner.
        let mut b = features(&[60, 141]);
        b.all[1].pixel.x = 3.0;
        assert_eq!(match_features(&features(&[100]), &b).len(), 1);
        b.all[1].pixel.x = 5.0;
        assert_eq!(match_features(&features(&[100]), &b).len(), 0);
    }
}
