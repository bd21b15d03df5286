//! Bindings of the pulse kernels.

use numpy::{AsSliceError, Element, IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1};
use numpy::{PyUntypedArray, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::guard;
use crate::error::{Error, Result};
use crate::pulse::{self, Sample};
use crate::stop::Stop;

/// Samples of any accepted type, borrowed.
enum Samples<'py> {
    Float32(PyReadonlyArray1<'py, f32>),
    Float64(PyReadonlyArray1<'py, f64>),
    Int16(PyReadonlyArray1<'py, i16>),
}
