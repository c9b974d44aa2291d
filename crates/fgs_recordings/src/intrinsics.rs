//! Cameras of recordings whose frames have intrinsics of their own.

use std::cmp::Ordering;
use std::path::Path;

use fgs_data::DataError;
use fgs_geom::Intrinsics;

use crate::fault::fault;

/// Images whose proportions differ by more are not the camera's.
const MAX_ASPECT_ERROR: f64 = 0.02;

/// The median of each number: the camera that most frames hardly differ from. `None` without any.
pub(crate) fn median(of_frames: &[Intrinsics]) -> Option<Intrinsics> {
    let middle = |value: fn(&Intrinsics) -> f64| {
        let mut values: Vec<f64> = of_frames.iter().map(value).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied()
    };
    Some(Intrinsics {
        fx: middle(|k| k.fx)?,
        fy: middle(|k| k.fy)?,
        cx: middle(|k| k.cx)?,
        cy: middle(|k| k.cy)?,
    })
}

/// The same camera in images of another size, pixel centres at integers. `path` is for messages.
///
/// # Errors
/// If the images have other proportions: turned ones, for example, would be seen through a lens that is
/// not turned.
pub(crate) fn resized(
    path: &Path,
    k: &Intrinsics,
    from: (usize, usize),
    to: (usize, usize),
) -> Result<Intrinsics, DataError> {
    if from == to {
        // To the last bit.
        return Ok(*k);
    }
    let scale = |from: usize, to: usize| to as f64 / from as f64;
    let (x, y) = (scale(from.0, to.0), scale(from.1, to.1));
    // Not a number is none either.
    if (x / y - 1.0).abs().partial_cmp(&MAX_ASPECT_ERROR) != Some(Ordering::Less) {
        return Err(fault(
            path,
            format!(
                "describes a camera of {}x{} pixels, but its images are {}x{}",
                from.0, from.1, to.0, to.1
            ),
        ));
    }
    Ok(Intrinsics {
        fx: x * k.fx,
        fy: y * k.fy,
        cx: x * (k.cx + 0.5) - 0.5,
        cy: y * (k.cy + 0.5) - 0.5,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_is_of_each_number() {
        let k = |fx, cx| Intrinsics {
            fx,
            fy: 2.0 * fx,
            cx,
            cy: 1.0,
        };
        let middle = median(&[k(3.0, 9.0), k(1.0, 8.0), k(2.0, 7.0)]);
        assert_eq!(middle, Some(k(2.0, 8.0)));
        assert_eq!(median(&[]), None);
    }

    #[test]
    fn other_sizes_have_the_same_field_of_view() {
        let k = Intrinsics {
            fx: 100.0,
            fy: 90.0,
            cx: 39.5,
            cy: 20.0,
        };
        let resize = |to| resized(Path::new("x"), &k, (80, 60), to);
        let double = resize((160, 120)).unwrap();
        assert_eq!((double.fx, double.fy), (200.0, 180.0));
        assert_eq!((double.cx, double.cy), (79.5, 40.5));
        assert!(resize((60, 80)).is_err() && resize((0, 0)).is_err());
    }
}
