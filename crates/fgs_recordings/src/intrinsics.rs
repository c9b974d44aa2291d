//! Cameras of recordings whose frames have intrinsics of their own.

use fgs_geom::Intrinsics;

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

/// The same camera in images of another size, pixel centres at integers.
pub(crate) fn resized(k: &Intrinsics, from: (usize, usize), to: (usize, usize)) -> Intrinsics {
    if from == to {
        // To the last bit.
        return *k;
    }
    let scale = |from: usize, to: usize| to as f64 / from as f64;
    let (x, y) = (scale(from.0, to.0), scale(from.1, to.1));
    Intrinsics {
        fx: x * k.fx,
        fy: y * k.fy,
        cx: x * (k.cx + 0.5) - 0.5,
        cy: y * (k.cy + 0.5) - 0.5,
    }
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
}
