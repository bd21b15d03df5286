//! Bindings of the linear kernels.

use numpy::{Complex64, PyArray2, PyArray3};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use super::arrays::{Vector, borrow, hand_back};
use super::guard;
use crate::linear::{OUTPUTS, Output, PARAMETERS, Parameters, Response, response};

type ComplexRows<'py> = Bound<'py, PyArray2<Complex64>>;

fn run_response(
    py: Python<'_>,
    parameters: &Bound<'_, PyAny>,
    frequency_hz: &Bound<'_, PyAny>,
    outputs: &[usize],
    wrt: &[usize],
) -> PyResult<(Response, usize)> {
    let parameters: Vector<'_> = borrow("parameters", parameters)?;
    let frequency_hz: Vector<'_> = borrow("frequency_hz", frequency_hz)?;
    let (parameters, frequency_hz) = (parameters.as_slice()?, frequency_hz.as_slice()?);
    let result = guard::run(py, frequency_hz.len(), |_| {
        response(&Parameters::new(parameters)?, frequency_hz, &Output::from_indices(outputs)?, wrt)
    })?;
    Ok((result, frequency_hz.len()))
}

/// Exact frequency response of the linear structure from the set point, dead times included; complex [O, F].
#[pyfunction]
fn linear_response<'py>(
    py: Python<'py>,
    parameters: &Bound<'py, PyAny>,
    frequency_hz: &Bound<'py, PyAny>,
    outputs: Vec<usize>,
) -> PyResult<ComplexRows<'py>> {
    let (result, count) = run_response(py, parameters, frequency_hz, &outputs, &[])?;
    hand_back(py, result.values, [outputs.len(), count])
}

/// Frequency response [O, F] and its derivatives [W, O, F] by the parameters of index `wrt`.
#[pyfunction]
fn linear_response_sensitivities<'py>(
    py: Python<'py>,
    parameters: &Bound<'py, PyAny>,
    frequency_hz: &Bound<'py, PyAny>,
    outputs: Vec<usize>,
    wrt: Vec<usize>,
) -> PyResult<(ComplexRows<'py>, Bound<'py, PyArray3<Complex64>>)> {
    let (result, count) = run_response(py, parameters, frequency_hz, &outputs, &wrt)?;
    Ok((
        hand_back(py, result.values, [outputs.len(), count])?,
        hand_back(py, result.derivatives, [wrt.len(), outputs.len(), count])?,
    ))
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("LINEAR_PARAMETERS", PyTuple::new(module.py(), PARAMETERS)?)?;
    module.add("LINEAR_OUTPUTS", PyTuple::new(module.py(), OUTPUTS)?)?;
    module.add_function(wrap_pyfunction!(linear_response, module)?)?;
    module.add_function(wrap_pyfunction!(linear_response_sensitivities, module)?)?;
    Ok(())
}
