//! Arrays from Python: which layouts are accepted, and messages that name a refused argument.

use numpy::ndarray::{Dim, Dimension};
use numpy::{
    Element, IntoPyArray, Ix1, Ix2, PyArray, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray,
    PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::prelude::*;

use super::guard;
use crate::error::{Error, Result, require};
use crate::stop::Stop;

/// Borrow an aligned C-contiguous array of type `T` with as many axes as `D`; an error reports the array's actual type
/// and layout.
pub fn borrow<'py, T: Element, D: Dimension>(
    name: &str,
    array: &Bound<'py, PyAny>,
) -> PyResult<PyReadonlyArray<'py, T, D>> {
    let fault = match array.cast::<PyArray<T, D>>() {
        Ok(array) if !array.is_c_contiguous() => ", not C-contiguous",
        Ok(array) if !array.is_empty() && !(array.data() as usize).is_multiple_of(align_of::<T>()) => {
            ", not aligned"
        }
        Ok(array) => {
            return array.try_readonly().map_err(|_| {
                let message =
                    format!("{name}: found an array that another call is writing to, expected one at rest");
                Error::Invalid(message).into()
            });
        }
        Err(_) => "",
    };
    let axes = D::NDIM.unwrap_or_default();
    let found = match array.cast::<PyUntypedArray>() {
        Ok(array) => {
            let fault =
                if fault.is_empty() && !array.is_c_contiguous() { ", not C-contiguous" } else { fault };
            format!("{} of shape {:?}{fault}", array.dtype(), array.shape())
        }
        Err(_) => array.get_type().to_string(),
    };
    let expected = T::get_dtype(array.py());
    Err(Error::Invalid(format!(
        "{name}: found {found}, expected a C-contiguous {expected} array of {axes} axes"
    ))
    .into())
}

/// Check that an array has the shape that the other arguments require.
pub fn expect_shape<const N: usize>(
    name: &str,
    found: &[usize],
    expected: [usize; N],
    meaning: &str,
) -> PyResult<()> {
    Ok(require(found == expected, || {
        format!("{name}: found an array of shape {found:?}, expected {expected:?} ({meaning})")
    })?)
}

/// Uninitialised array of a shape; failed allocation is a `MemoryError`, while the crate's constructor would panic.
fn unfilled<const N: usize>(
    py: Python<'_>,
    shape: [usize; N],
) -> PyResult<Bound<'_, PyArray<f64, Dim<[usize; N]>>>>
where
    Dim<[usize; N]>: Dimension,
{
    let bytes = shape.iter().try_fold(size_of::<f64>(), |bytes, &length| bytes.checked_mul(length));
    if bytes.is_none_or(|bytes| isize::try_from(bytes).is_err()) {
        return Err(Error::Memory { bytes: bytes.unwrap_or(usize::MAX) }.into());
    }
    let array = py.import("numpy")?.call_method1("empty", (shape.to_vec(),))?;
    Ok(array.cast_into()?)
}

/// Array of a shape that a guarded kernel writes completely, in about `work` inner steps.
pub fn filled<const N: usize>(
    py: Python<'_>,
    shape: [usize; N],
    work: usize,
    kernel: impl FnOnce(&mut [f64], &Stop) -> Result<()> + Send,
) -> PyResult<Bound<'_, PyArray<f64, Dim<[usize; N]>>>>
where
    Dim<[usize; N]>: Dimension,
{
    let array = unfilled(py, shape)?;
    {
        let mut values = array.readwrite();
        let values = values.as_slice_mut()?;
        guard::run(py, work, |stop| kernel(values, stop))?;
    }
    Ok(array)
}

/// Outputs [O, N] and their derivatives [W, O, N].
pub type Sensitivities<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray3<f64>>);

/// Outputs [O, N] and their derivatives [W, O, N], which a guarded kernel writes completely, in about `work` inner steps.
pub fn filled_with_derivatives(
    py: Python<'_>,
    [by, outputs, samples]: [usize; 3],
    work: usize,
    kernel: impl FnOnce(&mut [f64], &mut [f64], &Stop) -> Result<()> + Send,
) -> PyResult<Sensitivities<'_>> {
    let derivatives = unfilled(py, [by, outputs, samples])?;
    let values = {
        let mut slopes = derivatives.readwrite();
        let slopes = slopes.as_slice_mut()?;
        filled(py, [outputs, samples], work, |values, stop| kernel(values, slopes, stop))?
    };
    Ok((values, derivatives))
}

/// Return spans to Python, int64 [K, 2]: the first sample and one past the last.
pub fn hand_back_spans(
    py: Python<'_>,
    spans: impl Iterator<Item = (u64, u64)>,
) -> PyResult<Bound<'_, PyArray2<i64>>> {
    let flat: Vec<i64> = spans.flat_map(|(start, stop)| [start, stop]).map(u64::cast_signed).collect();
    let count = flat.len() / 2;
    hand_back(py, flat, [count, 2])
}

/// Return values to Python as an array of a shape, without a copy.
pub fn hand_back<const N: usize, T: Element>(
    py: Python<'_>,
    values: Vec<T>,
    shape: [usize; N],
) -> PyResult<Bound<'_, PyArray<T, Dim<[usize; N]>>>>
where
    Dim<[usize; N]>: Dimension,
    [usize; N]: numpy::ndarray::IntoDimension<Dim = Dim<[usize; N]>>,
{
    values.into_pyarray(py).reshape(shape)
}

/// An array of one axis.
pub type Vector<'py> = PyReadonlyArray<'py, f64, Ix1>;
/// An array of two axes.
pub type Matrix<'py> = PyReadonlyArray<'py, f64, Ix2>;
