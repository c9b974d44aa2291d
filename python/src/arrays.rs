//! NumPy arrays in and out. What comes in is copied once, since the system keeps frames; what goes out is
//! the memory that Rust computed it in.

use fgs_geom::{Camera, Image, Se3};
use nalgebra::Matrix4;
use numpy::ndarray::{ArrayBase, Data, Dimension, Ix1, Ix2, Ix3};
use numpy::{
    Element, PyArray, PyArray1, PyArray2, PyArray3, PyArrayDescrMethods, PyArrayMethods,
    PyReadonlyArray, PyUntypedArray, PyUntypedArrayMethods, get_array_module,
};
use pyo3::prelude::*;
use pyo3::types::IntoPyDict;

use crate::errors::{SettingError, ShapeError};

/// An array of one type and number of dimensions.
///
/// # Errors
/// `ShapeError` in words: `expected` is what `name` should be.
fn array<'py, T: Element, D: Dimension>(
    value: &Bound<'py, PyAny>,
    name: &str,
    expected: &str,
) -> PyResult<PyReadonlyArray<'py, T, D>> {
    let array = as_array(value)?;
    match array.cast::<PyArray<T, D>>() {
        Ok(array) => Ok(array.try_readonly()?),
        Err(_) => Err(unexpected(&array, name, expected)),
    }
}

/// The same of any type of numbers, which is converted if it is another.
fn float_array<'py, T: Element, D: Dimension>(
    value: &Bound<'py, PyAny>,
    name: &str,
    expected: &str,
) -> PyResult<PyReadonlyArray<'py, T, D>> {
    let own = as_array(value)?;
    if !b"fiu".contains(&own.dtype().kind()) {
        return Err(unexpected(&own, name, expected));
    }
    let as_it_is = [("copy", false)].into_py_dict(value.py())?;
    let dtype = numpy::dtype::<T>(value.py());
    let converted = own.call_method("astype", (dtype,), Some(&as_it_is))?;
    array(&converted, name, expected).map_err(|_| unexpected(&own, name, expected))
}

fn as_array<'py>(value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyUntypedArray>> {
    let array = match value.cast::<PyUntypedArray>() {
        Ok(array) => array.clone(),
        Err(_) => get_array_module(value.py())?
            .call_method1("asarray", (value,))?
            .cast_into()?,
    };
    Ok(array)
}

fn unexpected(array: &Bound<'_, PyUntypedArray>, name: &str, expected: &str) -> PyErr {
    let (shape, dtype) = (array.shape(), array.dtype());
    ShapeError::new_err(format!(
        "{name}: expected {expected}, got {dtype} of shape {shape:?}"
    ))
}

/// Row by row, whatever the strides.
fn elements<T: Copy, S: Data<Elem = T>, D: Dimension>(array: &ArrayBase<S, D>) -> Vec<T> {
    match array.as_slice() {
        Some(slice) => slice.to_vec(),
        None => array.iter().copied().collect(),
    }
}

/// Element k of each row of N.
fn rows<T: Copy, const N: usize, S: Data<Elem = T>, D: Dimension>(
    array: &ArrayBase<S, D>,
) -> Vec<[T; N]> {
    match array.as_slice() {
        Some(slice) => slice.as_chunks().0.to_vec(),
        None => elements(array).as_chunks().0.to_vec(),
    }
}

/// A colour image, uint8 of shape (H, W, 3).
pub fn color_image(value: &Bound<'_, PyAny>) -> PyResult<Image<[u8; 3]>> {
    let expected = "uint8 of shape (H, W, 3)";
    let array = array::<u8, Ix3>(value, "color", expected)?;
    let (height, width) = (array.shape()[0], array.shape()[1]);
    if array.shape()[2] != 3 {
        return Err(unexpected(array.as_untyped(), "color", expected));
    }
    image(width, height, rows(&array.as_array()))
}

/// A grey image, uint8 of shape (H, W).
pub fn gray_image(value: &Bound<'_, PyAny>) -> PyResult<Image<u8>> {
    let array = array::<u8, Ix2>(value, "image", "uint8 of shape (H, W) or (H, W, 3)")?;
    let (height, width) = (array.shape()[0], array.shape()[1]);
    image(width, height, elements(&array.as_array()))
}

/// Whether a value has three dimensions.
pub fn has_channels(value: &Bound<'_, PyAny>) -> PyResult<bool> {
    Ok(as_array(value)?.ndim() == 3)
}

/// A depth image, any floating type of shape (H, W), metres.
pub fn depth_image(value: &Bound<'_, PyAny>) -> PyResult<Image<f32>> {
    let expected = "metres as float32 or float64 of shape (H, W)";
    let own = as_array(value)?;
    // Whole numbers are a sensor's units.
    if own.dtype().kind() != b'f' {
        return Err(unexpected(&own, "depth_m", expected));
    }
    let array = float_array::<f32, Ix2>(value, "depth_m", expected)?;
    let (height, width) = (array.shape()[0], array.shape()[1]);
    image(width, height, elements(&array.as_array()))
}

fn image<T>(width: usize, height: usize, data: Vec<T>) -> PyResult<Image<T>> {
    Image::new(width, height, data).map_err(|error| ShapeError::new_err(error.to_string()))
}

/// Rows of N numbers, any numbers of shape (M, N).
pub fn float_rows<const N: usize>(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<[f32; N]>> {
    let expected = format!("float32 or float64 of shape (N, {N})");
    let array = float_array::<f32, Ix2>(value, name, &expected)?;
    if array.shape()[1] != N {
        return Err(unexpected(array.as_untyped(), name, &expected));
    }
    Ok(rows(&array.as_array()))
}

/// Images of 8K: what fits in memory.
const MAX_PIXELS: usize = 7680 * 4320;

/// Refuses images that do not fit in memory.
pub fn check_size(camera: &Camera) -> PyResult<()> {
    let Camera { width, height, .. } = *camera;
    if width.saturating_mul(height) <= MAX_PIXELS {
        return Ok(());
    }
    Err(SettingError::new_err(format!(
        "images of {width}x{height}: at most {MAX_PIXELS} pixels are possible"
    )))
}

/// Numbers of shape (N,).
pub fn floats(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<f32>> {
    let array = float_array::<f32, Ix1>(value, name, "float32 or float64 of shape (N,)")?;
    Ok(elements(&array.as_array()))
}

/// Times, seconds, any numbers of shape (N,).
pub fn times(value: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
    let array = float_array::<f64, Ix1>(value, "timestamps", "seconds as float64 of shape (N,)")?;
    Ok(elements(&array.as_array()))
}

/// Two arrays that should be of one length.
pub fn unequal(a: &str, a_len: usize, b: &str, b_len: usize) -> PyErr {
    ShapeError::new_err(format!("{a} and {b} differ in length: {a_len} and {b_len}"))
}

/// Flags, bool of shape (N,).
pub fn flags(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<bool>> {
    let array = array::<bool, Ix1>(value, name, "bool of shape (N,)")?;
    Ok(elements(&array.as_array()))
}

/// A pose, any numbers of shape (4, 4).
pub fn pose(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Se3> {
    let array = float_array::<f64, Ix2>(value, name, "a matrix of shape (4, 4)")?;
    if array.shape() != [4, 4] {
        return Err(unexpected(
            array.as_untyped(),
            name,
            "a matrix of shape (4, 4)",
        ));
    }
    rigid(&elements(&array.as_array()), name)
}

/// Poses, any numbers of shape (N, 4, 4).
pub fn poses(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<Se3>> {
    let expected = "poses of shape (N, 4, 4)";
    let array = float_array::<f64, Ix3>(value, name, expected)?;
    if array.shape()[1..] != [4, 4] {
        return Err(unexpected(array.as_untyped(), name, expected));
    }
    let values = elements(&array.as_array());
    let matrices = values.as_chunks::<16>().0.iter().zip(0_usize..);
    matrices
        .map(|(matrix, i)| rigid(matrix, &format!("{name}[{i}]")))
        .collect()
}

fn rigid(values: &[f64], name: &str) -> PyResult<Se3> {
    let matrix = Matrix4::from_row_slice(values);
    let last = matrix.row(3) == Matrix4::<f64>::identity().row(3);
    Se3::from_matrix(&matrix)
        .filter(|_| last)
        .ok_or_else(|| ShapeError::new_err(format!("{name}: not a rotation with a translation")))
}

/// A pose as a matrix, float64 of shape (4, 4).
pub fn matrix<'py>(py: Python<'py>, pose: &Se3) -> PyResult<Bound<'py, PyArray2<f64>>> {
    square(py, &pose.matrix())
}

/// A square matrix, float64.
pub fn square<'py, const N: usize>(
    py: Python<'py>,
    matrix: &nalgebra::SMatrix<f64, N, N>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    PyArray1::from_slice(py, matrix.transpose().as_slice()).reshape([N, N])
}

/// Poses as matrices, float64 of shape (N, 4, 4).
pub fn matrices<'py>(
    py: Python<'py>,
    poses: impl ExactSizeIterator<Item = Se3>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let shape = [poses.len(), 4, 4];
    let mut values = Vec::with_capacity(16 * poses.len());
    for pose in poses {
        values.extend_from_slice(pose.matrix().transpose().as_slice());
    }
    PyArray1::from_vec(py, values).reshape(shape)
}

/// Rows of N numbers, of shape (M, N), in the vector's memory.
pub fn from_rows<T: Element, const N: usize>(
    py: Python<'_>,
    rows: Vec<[T; N]>,
) -> PyResult<Bound<'_, PyArray2<T>>> {
    let shape = [rows.len(), N];
    PyArray1::from_vec(py, rows.into_flattened()).reshape(shape)
}

/// A one-channel image, of shape (H, W), in the image's memory.
pub fn from_image<T: Element>(py: Python<'_>, image: Image<T>) -> PyResult<Bound<'_, PyArray2<T>>> {
    let shape = [image.height(), image.width()];
    PyArray1::from_vec(py, image.into_data()).reshape(shape)
}

/// A three-channel image, of shape (H, W, 3), in the image's memory.
pub fn from_color<T: Element>(
    py: Python<'_>,
    image: Image<[T; 3]>,
) -> PyResult<Bound<'_, PyArray3<T>>> {
    let shape = [image.height(), image.width(), 3];
    PyArray1::from_vec(py, image.into_data().into_flattened()).reshape(shape)
}
