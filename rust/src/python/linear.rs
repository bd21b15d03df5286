//! Bindings of the linear kernels.

use numpy::{Complex64, PyArray2, PyArray3};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use super::arrays::{Sensitivities, Vector, borrow, filled_with_derivatives, hand_back};
use super::guard;
use crate::hold::Hold;
use crate::linear::{By, Drive, OUTPUTS, Output, PARAMETERS, Parameters, Response, response, simulate};

/// State updates that a response at one frequency is worth, in time.
const RESPONSE: usize = 16;

type ComplexRows<'py> = Bound<'py, PyArray2<Complex64>>;
type Rows<'py> = Bound<'py, PyArray2<f64>>;

/// Simulate the linear structure; [O, N].
#[pyfunction]
fn simulate_linear<'py>(
    py: Python<'py>,
    parameters: &Bound<'py, PyAny>,
    dn_set: &Bound<'py, PyAny>,
    dt: f64,
    hold: Hold,
    initial: &Bound<'py, PyAny>,
    outputs: Vec<usize>,
) -> PyResult<Rows<'py>> {
    Ok(linear_sensitivities(py, parameters, dn_set, dt, hold, initial, outputs, vec![])?.0)
}

/// Simulated outputs [O, N] and their derivatives [W, O, N] by the parameters of index `wrt`, 9 and 10 the initial dn and dE.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
fn linear_sensitivities<'py>(
    py: Python<'py>,
    parameters: &Bound<'py, PyAny>,
    dn_set: &Bound<'py, PyAny>,
    dt: f64,
    hold: Hold,
    initial: &Bound<'py, PyAny>,
    outputs: Vec<usize>,
    wrt: Vec<usize>,
) -> PyResult<Sensitivities<'py>> {
    let parameters: Vector<'_> = borrow("parameters", parameters)?;
    let dn_set: Vector<'_> = borrow("dn_set", dn_set)?;
    let initial: Vector<'_> = borrow("initial", initial)?;
    let parameters = Parameters::new(parameters.as_slice()?, "parameters")?;
    let drive = Drive::new(dn_set.as_slice()?, dt, hold, initial.as_slice()?)?;
    let (outputs, wrt) = (Output::from_indices(&outputs)?, By::from_indices(&wrt)?);
    let shape = [wrt.len(), outputs.len(), drive.samples()];
    let work = drive.samples() * (1 + wrt.len()) * outputs.len();
    filled_with_derivatives(py, shape, work, |values, derivatives, stop| {
        simulate(&parameters, &drive, &outputs, &wrt, values, derivatives, stop)
    })
}

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
    let result = guard::run(py, frequency_hz.len() * (1 + wrt.len()) * RESPONSE, |stop| {
        let (outputs, wrt) = (Output::from_indices(outputs)?, By::parameters_from_indices(wrt)?);
        response(&Parameters::new(parameters, "parameters")?, frequency_hz, &outputs, &wrt, stop)
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
    module.add_function(wrap_pyfunction!(simulate_linear, module)?)?;
    module.add_function(wrap_pyfunction!(linear_sensitivities, module)?)?;
    module.add_function(wrap_pyfunction!(linear_response, module)?)?;
    module.add_function(wrap_pyfunction!(linear_response_sensitivities, module)?)?;
    Ok(())
}
