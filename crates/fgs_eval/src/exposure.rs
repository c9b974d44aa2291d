//! A frame's exposure against the map's: for each colour channel the gain and offset that bring a
//! render nearest to the camera's image. A camera changes both on its own; what is left of the
//! difference is the map's.

/// Sums over pixels of one channel: rendered values `r` and true values `t`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ChannelMoments {
    count: f64,
    r: f64,
    t: f64,
    rr: f64,
    rt: f64,
    tt: f64,
}

/// `true value = gain * rendered value + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Exposure {
    pub gain: f64,
    pub offset: f64,
}

impl ChannelMoments {
    pub fn add(&mut self, rendered: f64, truth: f64) {
        self.count += 1.0;
        self.r += rendered;
        self.t += truth;
        self.rr += rendered * rendered;
        self.rt += rendered * truth;
        self.tt += truth * truth;
    }

    pub fn merged(self, other: &Self) -> Self {
        Self {
            count: self.count + other.count,
            r: self.r + other.r,
            t: self.t + other.t,
            rr: self.rr + other.rr,
            rt: self.rt + other.rt,
            tt: self.tt + other.tt,
        }
    }

    /// The exposure of least squares; where the render is of one value, an offset alone.
    pub fn exposure(&self) -> Exposure {
        let count = self.count.max(1.0);
        let (mean_r, mean_t) = (self.r / count, self.t / count);
        let variance = self.rr / count - mean_r * mean_r;
        let covariance = self.rt / count - mean_r * mean_t;
        let gain = if variance > 1e-9 {
            covariance / variance
        } else {
            1.0
        };
        Exposure {
            gain,
            offset: mean_t - gain * mean_r,
        }
    }

    /// The sum of squared differences under an exposure.
    pub fn squared_error(&self, exposure: &Exposure) -> f64 {
        let Exposure { gain, offset } = *exposure;
        let of_render = gain * gain * self.rr + 2.0 * gain * offset * self.r;
        let of_both = -2.0 * (gain * self.rt + offset * self.t);
        (self.tt + of_render + of_both + offset * offset * self.count).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_affine_change_is_found_and_leaves_no_error() {
        let mut moments = ChannelMoments::default();
        for i in 0..50 {
            let rendered = f64::from((i * 37) % 50) / 50.0;
            moments.add(rendered, 0.8 * rendered + 0.1);
        }
        let exposure = moments.exposure();
        assert!((exposure.gain - 0.8).abs() <= 1e-12 && (exposure.offset - 0.1).abs() <= 1e-12);
        assert!(moments.squared_error(&exposure) <= 1e-12);
    }

    #[test]
    fn the_error_is_the_sum_over_pixels_and_no_other_exposure_has_less() {
        let pairs = [(0.1, 0.4), (0.5, 0.2), (0.9, 0.95), (0.3, 0.3)];
        let mut moments = ChannelMoments::default();
        pairs.iter().for_each(|(r, t)| moments.add(*r, *t));
        let error = |gain: f64, offset: f64| {
            let squared = pairs.iter().map(|(r, t)| (t - gain * r - offset).powi(2));
            squared.sum::<f64>()
        };
        let Exposure { gain, offset } = moments.exposure();
        let found = moments.squared_error(&Exposure { gain, offset });
        assert!((found - error(gain, offset)).abs() <= 1e-12);
        for (dg, d_offset) in [(0.01, 0.0), (-0.01, 0.0), (0.0, 0.01), (0.0, -0.01)] {
            assert!(error(gain + dg, offset + d_offset) > found);
        }
    }

    #[test]
    fn a_render_of_one_value_gets_an_offset() {
        let mut moments = ChannelMoments::default();
        moments.add(0.5, 0.7);
        moments.add(0.5, 0.9);
        let exposure = moments.exposure();
        assert_eq!(exposure.gain, 1.0);
        assert!((exposure.offset - 0.3).abs() <= 1e-12);
    }
}
