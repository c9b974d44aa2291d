//! What every rasteriser of this crate agrees on: the constants of image formation, and the inputs
//! and outputs of rendering and of its derivative (paper Sec. III, Eq. 1).
//!
//! Gaussians are blended front to back by the z of their centres (ties: by index) over black:
//! `color = sum w_i c_i`, `depth = sum w_i z_i`, `alpha = sum w_i`, `w_i = T_i alpha_i`,
//! `T_i = prod_{j < i} (1 - alpha_j)`, `alpha_i = min(ALPHA_MAX, o_i exp(-d^T cov2d^-1 d / 2))`.

use fgs_geom::{Camera, Image};

/// A smaller alpha is dropped: it changes an 8-bit image by less than one level. This bounds the
/// support of a gaussian of opacity `o` to `sqrt(2 ln(255 o))` standard deviations.
pub(crate) const ALPHA_MIN: f64 = 1.0 / 255.0;

/// Alpha is clamped to this, so that the transmittance never becomes 0 and the backward pass can
/// divide by `1 - alpha`. A clamped alpha has no gradient.
pub(crate) const ALPHA_MAX: f64 = 0.99;

/// A pixel with less transmittance is saturated: it takes no further gaussians.
pub(crate) const TRANSMITTANCE_MIN: f64 = 1e-4;

/// Low-pass filter: added to both variances of a projected gaussian, px^2, so that none falls
/// between pixels.
pub(crate) const LOW_PASS_PX2: f64 = 0.3;

/// Near plane: gaussians with a smaller z of the centre are not drawn, metres.
pub(crate) const NEAR_M: f64 = 0.2;

/// The projection is linearised at the centre's direction, clamped per axis to this multiple of
/// the image's half extent about the image's middle (not the principal point): further out the
/// linear approximation blows up.
pub(crate) const FRUSTUM_MARGIN: f64 = 1.3;

/// Below this |cos| between a pixel's ray and the disk's normal, the disk is seen almost edge-on and
/// the depth of its plane is meaningless: the centre's depth is used.
pub(crate) const PLANE_MIN_COS: f64 = 0.1;

/// A gaussian with a parameter or a standard deviation (m) that is larger in magnitude or not finite
/// is damaged and not drawn. Within the limit no product of the projection overflows `f32` unnoticed.
pub(crate) const MAX_MAGNITUDE: f64 = 1e9;

/// A gaussian with a larger projected variance (standard deviation of a million pixels) is not drawn.
pub(crate) const MAX_VARIANCE_PX2: f64 = 1e12;

/// A quaternion with a smaller squared norm cannot be normalised; its gaussian is not drawn.
pub(crate) const MIN_QUAT_NORM2: f64 = 1e-12;

/// The output of rendering: three images of the camera's size.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rendered<T = f32> {
    /// Linear blend of the gaussians' RGB over black.
    pub color: Image<[T; 3]>,
    /// Sum of weight times depth along z, metres; not divided by alpha. A gaussian's depth at a
    /// pixel is where the pixel's ray meets the plane of the disk (its third axis is the normal).
    pub depth_m: Image<T>,
    /// Accumulated weight, 0 to 1.
    pub alpha: Image<T>,
}

impl Rendered {
    /// Depth along z at pixel (u, v), metres, normalised by alpha: not finite where nothing is
    /// rendered.
    ///
    /// # Panics
    /// If the pixel lies outside.
    pub fn surface_depth_m(&self, u: usize, v: usize) -> f32 {
        self.depth_m.at(u, v) / self.alpha.at(u, v)
    }

    /// Colour, nominally 0 to 1, as bytes.
    pub fn color_bytes(&self) -> Image<[u8; 3]> {
        (self.color).map(|pixel| pixel.map(|value| (255.0 * value.clamp(0.0, 1.0)).round() as u8))
    }
}

impl<T: Copy + Default> Rendered<T> {
    /// Resizes the images; their contents are then unspecified.
    pub(crate) fn resize(&mut self, width: usize, height: usize) {
        resize(&mut self.color, width, height);
        resize(&mut self.depth_m, width, height);
        resize(&mut self.alpha, width, height);
    }
}

fn resize<X: Copy + Default>(image: &mut Image<X>, width: usize, height: usize) {
    if (image.width(), image.height()) != (width, height) {
        *image = Image::filled(width, height, X::default());
    }
}

/// The loss's derivatives with respect to the images of [`Rendered`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cotangents<T = f32> {
    /// Colour.
    pub d_color: Image<[T; 3]>,
    /// Depth (not divided by alpha), 1/m.
    pub d_depth_m: Image<T>,
    /// Alpha.
    pub d_alpha: Image<T>,
}

impl<T: Copy + Default> Cotangents<T> {
    /// Zeros of the camera's size.
    pub fn zeros(camera: &Camera) -> Self {
        let (width, height) = (camera.width, camera.height);
        Self {
            d_color: Image::filled(width, height, [T::default(); 3]),
            d_depth_m: Image::filled(width, height, T::default()),
            d_alpha: Image::filled(width, height, T::default()),
        }
    }

    /// Resizes the images; their contents are then unspecified.
    pub(crate) fn resize(&mut self, width: usize, height: usize) {
        resize(&mut self.d_color, width, height);
        resize(&mut self.d_depth_m, width, height);
        resize(&mut self.d_alpha, width, height);
    }
}

/// The loss's derivatives with respect to a gaussian's stored parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GaussianGradient<T = f32> {
    /// Centre, world axes, 1/m.
    pub d_mean: [T; 3],
    /// Quaternion as stored, wxyz (through its normalisation).
    pub d_quat: [T; 4],
    /// Logarithms of the scales.
    pub d_log_scales: [T; 3],
    /// Opacity logit.
    pub d_opacity_logit: T,
    /// Colour coefficients.
    pub d_sh: [T; 3],
}

/// The gradients of the M gaussians that contribute to a view; those of all others are zero.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GaussianGradients<T = f32> {
    /// Indices of the gaussians that contributed to a pixel, ascending, `[M]`.
    pub touched: Vec<u32>,
    /// Entry k belongs to gaussian `touched[k]`, `[M]`.
    pub gradients: Vec<GaussianGradient<T>>,
}
