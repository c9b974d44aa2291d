//! Where an image is rich in detail.

use fgs_slam::frequency::{FrequencySegmenter, FrequencySettings};
use numpy::PyArray2;
use pyo3::prelude::*;

use crate::arrays;

/// Where an image is rich in detail, by its frequencies: the mask by which gaussians are placed.
///
/// Args:
///     image: sRGB, uint8 (H, W, 3), or grey, uint8 (H, W).
///     clahe: equalise contrast locally beforehand, as the system does by default.
///
/// Returns:
///     bool (H, W), true where the high-frequency response stands out.
///
/// Raises:
///     ShapeError: the array has another shape or type.
#[pyfunction]
#[pyo3(signature = (image, *, clahe = true))]
pub fn detail_mask<'py>(
    py: Python<'py>,
    image: &Bound<'py, PyAny>,
    clahe: bool,
) -> PyResult<Bound<'py, PyArray2<bool>>> {
    let mut segmenter = FrequencySegmenter::new(0, 0, FrequencySettings { clahe });
    let mask = if arrays::has_channels(image)? {
        let color = arrays::color_image(image)?;
        py.detach(|| segmenter.segment(&color))
    } else {
        let gray = arrays::gray_image(image)?;
        py.detach(|| segmenter.segment_gray(&gray))
    };
    arrays::from_image(py, mask)
}
