//! Arrays that cross the border: what Python may hand in, and a message that names the argument when it may not.

use numpy::ndarray::{Dim, Dimension};
use numpy::{
    Element, IntoPyArray, Ix1, PyArray, PyArrayMethods, PyReadonlyArray, PyUntypedArray,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;

use crate::error::Error;

/// Borrow a C-contiguous array of type `T` and of as many axes as `D` has, or say what was found.
pub fn borrow<'py, T: Element, D: Dimension>(
    name: &str,
    array: &Bound<'py, PyAny>,
) -> PyResult<PyReadonlyArray<'py, T, D>> {
    if let Ok(array) = array.cast::<PyArray<T, D>>()
        && array.is_c_contiguous()
    {
        return Ok(array.try_readonly()?);
    }
    let axes = D::NDIM.unwrap_or_default();
    let found = match array.cast::<PyUntypedArray>() {
        Ok(array) => {
            let order = if array.is_c_contiguous() { "" } else { ", not C-contiguous" };
            format!("{} of shape {:?}{order}", array.dtype(), array.shape())
        }
        Err(_) => array.get_type().to_string(),
    };
    let expected = T::get_dtype(array.py());
    Err(Error::Invalid(format!(
        "{name}: found {found}, expected a C-contiguous {expected} array of {axes} axes"
    ))
    .into())
}

/// Give the values to Python as an array of that shape, without a copy.
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
