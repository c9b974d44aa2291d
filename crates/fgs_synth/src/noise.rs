//! Deterministic 2D value noise from hashed lattice points.
//!
//! All functions are pure. Fine octaves fade out before they would alias.

/// A well-mixed 32-bit hash of a lattice point.
pub(crate) fn hash(x: i32, y: i32, seed: u32) -> u32 {
    let mut h = (x as u32).wrapping_mul(0x9E37_79B1)
        ^ (y as u32).wrapping_mul(0x85EB_CA77)
        ^ seed.wrapping_mul(0xC2B2_AE3D);
    h ^= h >> 15;
    h = h.wrapping_mul(0x2C1B_3C6D);
    h ^= h >> 12;
    h = h.wrapping_mul(0x297A_2D39);
    h ^ (h >> 15)
}

/// A hashed value in [0, 1) for a lattice point.
pub(crate) fn unit(x: i32, y: i32, seed: u32) -> f32 {
    (hash(x, y, seed) >> 8) as f32 / (1 << 24) as f32
}

/// Value noise in [-1, 1] on a lattice of spacing 1: random lattice values, interpolated with the
/// cubic smoothstep.
pub(crate) fn value_noise(x: f32, y: f32, seed: u32) -> f32 {
    let (x0, y0) = (x.floor(), y.floor());
    let smooth = |t: f32| t * t * (3.0 - 2.0 * t);
    let (a, b) = (smooth(x - x0), smooth(y - y0));
    let (i, j) = (x0 as i32, y0 as i32);
    let corner = |di: i32, dj: i32| unit(i.wrapping_add(di), j.wrapping_add(dj), seed);
    let near = corner(0, 0) * (1.0 - a) + corner(1, 0) * a;
    let far = corner(0, 1) * (1.0 - a) + corner(1, 1) * a;
    2.0 * (near * (1.0 - b) + far * b) - 1.0
}

/// Fractal Brownian motion, roughly in [-1, 1]: each octave has half the wavelength and 0.6 times
/// the amplitude of the one before. `wavelength` is that of the first octave and `footprint` the
/// size of a pixel, both in units of `u` and `v`. Octaves fade between wavelengths of 3 and 1.5
/// pixels; shorter ones are skipped.
pub(crate) fn fbm(
    [u, v]: [f32; 2],
    seed: u32,
    wavelength: f32,
    octaves: u32,
    footprint: f32,
) -> f32 {
    let (mut sum, mut amplitude, mut wavelength) = (0.0, 0.6, wavelength);
    for octave in 0..octaves {
        let visible = (wavelength / footprint / 1.5 - 1.0).clamp(0.0, 1.0);
        if visible == 0.0 {
            break;
        }
        // Offset the octaves from each other, so that their lattice lines do not coincide.
        let shift = 17.31 * octave as f32;
        let noise = value_noise(
            u / wavelength + shift,
            v / wavelength - shift,
            seed ^ octave,
        );
        sum += amplitude * visible * noise;
        amplitude *= 0.6;
        wavelength *= 0.5;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_continuous_bounded_and_centred() {
        let mut sum = 0.0;
        for i in 0..4000 {
            let (x, y) = (0.37 * i as f32 - 700.0, 0.91 * i as f32 - 300.0);
            let value = value_noise(x, y, 3);
            assert!(value.abs() <= 1.0);
            // Smoothstep has a slope of at most 1.5 and lattice values differ by at most 2.
            assert!((value_noise(x + 1e-2, y, 3) - value).abs() <= 0.031);
            sum += value;
        }
        assert!((sum / 4000.0).abs() <= 0.05);
    }

    #[test]
    fn detail_finer_than_a_pixel_is_left_out() {
        let fine = |footprint| fbm([0.4, 0.3], 1, 0.01, 3, footprint);
        assert_eq!(fine(0.01), 0.0);
        assert!(fine(0.0001).abs() > 0.0);
        // Halfway between wavelengths of 1.5 and 3 pixels, half the amplitude is left.
        let octave = |footprint| fbm([0.43, 0.31], 1, 0.1, 1, footprint);
        assert!((octave(0.1 / 2.25) - 0.5 * octave(1e-4)).abs() <= 1e-6);
        assert!(octave(1e-4).abs() >= 0.01);
    }
}
