//! Bindings of the linear recursion.

use numpy::{Ix3, PyReadonlyArray, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::arrays::{Matrix, Sensitivities, Vector, borrow, expect_shape, filled_with_derivatives};
use crate::error::require;
use crate::statespace::Recursion;

/// Run x[k+1] = F x[k] + G w[k], y[k] = C x[k] + D w[k] and its derivatives; w are shifted copies of a signal. Returns
/// [O, N] and [W, O, N].
#[pyfunction]
fn run_recursion<'py>(
    py: Python<'py>,
    system: &Bound<'py, PyAny>,
    start: &Bound<'py, PyAny>,
    signal: &Bound<'py, PyAny>,
    shifts: Vec<i64>,
    dt: f64,
) -> PyResult<Sensitivities<'py>> {
    let system: PyReadonlyArray<'_, f64, Ix3> = borrow("system", system)?;
    let start: Matrix<'_> = borrow("start", start)?;
    let signal: Vector<'_> = borrow("signal", signal)?;
    let (parts, states) = (start.shape()[0], start.shape()[1]);
    let rows = system.shape()[1];
    require(parts > 0 && rows > states, || {
        format!(
            "found {parts} systems of {rows} rows, expected at least one, of more rows than the {states} states"
        )
    })?;
    let columns = states + shifts.len();
    expect_shape(
        "system",
        system.shape(),
        [parts, rows, columns],
        "one a start, a column a state and a shift",
    )?;
    let signal = signal.as_slice()?;
    let shape = [parts - 1, rows - states, signal.len()];
    let recursion =
        Recursion::new(system.as_slice()?, start.as_slice()?, [states, shape[1]], signal, &shifts, dt)?;
    let work = signal.len().saturating_mul(rows * parts);
    filled_with_derivatives(py, shape, work, |values, slopes, stop| recursion.run(values, slopes, stop))
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(run_recursion, module)?)
}
