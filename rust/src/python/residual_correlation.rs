//! Bindings of the sums that the residual tests are made of.

use numpy::{PyArray2, PyArray4, PyReadonlyArray1, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::arrays::{Matrix, borrow, expect_shape, hand_back};
use super::guard;
use crate::residual_correlation::{Leftover, Shape};

type Sums<'py> = (Bound<'py, PyArray4<f64>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray4<f64>>);

/// Sums of products of lagged inputs (P rows, L lags), combinations of slopes (B) and residuals of each output (O):
/// ([P, L, O, B + 1], [P, L], [O, L + B, O, L + B]), the last of rows run backwards through each output's all-pole filter.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
fn leftover_sums<'py>(
    py: Python<'py>,
    set_points: &Bound<'py, PyAny>,
    lags: Vec<usize>,
    slopes: &Bound<'py, PyAny>,
    mix: &Bound<'py, PyAny>,
    residuals: &Bound<'py, PyAny>,
    valid: &Bound<'py, PyAny>,
    models: &Bound<'py, PyAny>,
) -> PyResult<Sums<'py>> {
    let set_points: Matrix<'_> = borrow("set_points", set_points)?;
    let slopes: Matrix<'_> = borrow("slopes", slopes)?;
    let mix: PyReadonlyArray3<'_, f64> = borrow("mix", mix)?;
    let residuals: Matrix<'_> = borrow("residuals", residuals)?;
    let valid: PyReadonlyArray1<'_, bool> = borrow("valid", valid)?;
    let models: Matrix<'_> = borrow("models", models)?;
    let [outputs, coefficients] = [models.shape()[0], models.shape()[1]];
    let shape = Shape { samples: valid.len(), inputs: set_points.shape()[0], basis: mix.shape()[1] };
    let reach = lags.iter().max().copied().unwrap_or_default().saturating_add(shape.samples);
    let rows = slopes.shape()[0];
    expect_shape("set_points", set_points.shape(), [shape.inputs, reach], "inputs, longest lag and samples")?;
    expect_shape("slopes", slopes.shape(), [rows, shape.samples], "slopes, samples")?;
    expect_shape(
        "mix",
        mix.shape(),
        [outputs, shape.basis, rows + 1],
        "outputs, basis, slopes and a constant",
    )?;
    expect_shape("residuals", residuals.shape(), [outputs, shape.samples], "outputs, samples")?;
    let models = models.as_slice()?;
    let models: Vec<_> =
        (0..outputs).map(|output| &models[output * coefficients..][..coefficients]).collect();
    let leftover = Leftover::new(
        shape,
        (set_points.as_slice()?, &lags),
        (slopes.as_slice()?, mix.as_slice()?),
        (residuals.as_slice()?, valid.as_slice()?),
        &models,
    )?;
    let each = lags.len() + shape.basis;
    let work = shape.samples.saturating_mul(outputs * each);
    let sum = guard::run(py, work, |stop| leftover.sum(stop))?;
    Ok((
        hand_back(py, sum.across, [shape.inputs, lags.len(), outputs, shape.basis + 1])?,
        hand_back(py, sum.squares, [shape.inputs, lags.len()])?,
        hand_back(py, sum.coloured, [outputs, each, outputs, each])?,
    ))
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(leftover_sums, module)?)?;
    Ok(())
}
