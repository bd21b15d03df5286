//! Bindings of the plant kernels.

use numpy::{PyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use super::arrays::{Vector, borrow, filled};
use crate::integrate::{Hold, ROWS, Run, Scheme, simulate};
use crate::plant::{Envelope, PARAMETERS};

/// Simulate one plant; rows `n_s`, `E_n`, `X_f`, `M_b`.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
fn simulate_plant<'py>(
    py: Python<'py>,
    parameters: &Bound<'py, PyAny>,
    limit_speed: &Bound<'py, PyAny>,
    limit_torque: &Bound<'py, PyAny>,
    n_set: &Bound<'py, PyAny>,
    dt: f64,
    substeps: usize,
    method: &str,
    hold: Hold,
    initial: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let parameters: Vector<'_> = borrow("parameters", parameters)?;
    let n_set: Vector<'_> = borrow("n_set", n_set)?;
    let initial: Vector<'_> = borrow("initial", initial)?;
    let envelope = envelope(limit_speed, limit_torque)?;
    let scheme = Scheme::new(dt, substeps, method.parse()?, hold)?;
    let run = Run::new(parameters.as_slice()?, n_set.as_slice()?, initial.as_slice()?)?;
    filled(py, [ROWS, n_set.len()], scheme.steps(n_set.len()), |values, stop| {
        simulate(&run, &envelope, &scheme, values, stop)
    })
}

pub(super) fn envelope(speed: &Bound<'_, PyAny>, torque: &Bound<'_, PyAny>) -> PyResult<Envelope> {
    let speed: Vector<'_> = borrow("limit_speed", speed)?;
    let torque: Vector<'_> = borrow("limit_torque", torque)?;
    Ok(Envelope::new(speed.as_slice()?, torque.as_slice()?)?)
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("PLANT_PARAMETERS", PyTuple::new(module.py(), PARAMETERS)?)?;
    module.add_function(wrap_pyfunction!(simulate_plant, module)?)?;
    Ok(())
}
