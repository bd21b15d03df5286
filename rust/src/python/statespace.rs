//! Bindings of the state-space kernels.

use numpy::{Complex64, PyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::arrays::{Matrix, Vector, borrow, filled, hand_back};
use super::guard;
use crate::error::require;
use crate::hold::Hold;
use crate::statespace::StateSpace;

fn model(
    a: &Bound<'_, PyAny>,
    b: &Bound<'_, PyAny>,
    c: &Bound<'_, PyAny>,
    d: &Bound<'_, PyAny>,
) -> PyResult<StateSpace> {
    let a: Matrix<'_> = borrow("A", a)?;
    let b: Vector<'_> = borrow("B", b)?;
    let c: Matrix<'_> = borrow("C", c)?;
    let d: Vector<'_> = borrow("D", d)?;
    for (name, found, expected) in
        [("A", a.shape(), [b.len(), b.len()]), ("C", c.shape(), [d.len(), b.len()])]
    {
        require(found == expected, || {
            format!(
                "{name} has shape {found:?}, expected {expected:?} with {} states in B and {} outputs in D",
                b.len(),
                d.len()
            )
        })?;
    }
    Ok(StateSpace::new(a.as_slice()?, b.as_slice()?, c.as_slice()?, d.as_slice()?)?)
}

/// Simulate x' = A x + B u, y = C x + D u with one input from the state `initial`; [O, N].
#[pyfunction]
#[pyo3(signature = (A, B, C, D, u, dt, hold, initial))]
#[allow(non_snake_case, clippy::too_many_arguments)]
fn simulate_statespace<'py>(
    py: Python<'py>,
    A: &Bound<'py, PyAny>,
    B: &Bound<'py, PyAny>,
    C: &Bound<'py, PyAny>,
    D: &Bound<'py, PyAny>,
    u: &Bound<'py, PyAny>,
    dt: f64,
    hold: Hold,
    initial: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let model = model(A, B, C, D)?;
    let input: Vector<'_> = borrow("u", u)?;
    let initial: Vector<'_> = borrow("initial", initial)?;
    let (input, initial) = (input.as_slice()?, initial.as_slice()?);
    let work = input.len().saturating_mul(model.states().saturating_mul(model.states() + model.outputs()));
    filled(py, [model.outputs(), input.len()], work, |rows, stop| {
        model.simulate(input, dt, hold, initial, rows, stop)
    })
}

/// Frequency response of the same model; complex [O, F].
#[pyfunction]
#[pyo3(signature = (A, B, C, D, frequency_hz))]
#[allow(non_snake_case)]
fn statespace_response<'py>(
    py: Python<'py>,
    A: &Bound<'py, PyAny>,
    B: &Bound<'py, PyAny>,
    C: &Bound<'py, PyAny>,
    D: &Bound<'py, PyAny>,
    frequency_hz: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray2<Complex64>>> {
    let model = model(A, B, C, D)?;
    let frequency_hz: Vector<'_> = borrow("frequency_hz", frequency_hz)?;
    let frequencies = frequency_hz.as_slice()?;
    let work = frequencies.len().saturating_mul(model.states().saturating_pow(3).max(16));
    let values = guard::run(py, work, |stop| model.response(frequencies, stop))?;
    hand_back(py, values, [model.outputs(), frequencies.len()])
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(simulate_statespace, module)?)?;
    module.add_function(wrap_pyfunction!(statespace_response, module)?)?;
    Ok(())
}
