//! Bindings of the simulation of the engine alone.

use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use super::arrays::{Vector, borrow, expect_shape};
use super::guard;
use crate::engine_side::{Measured, PARAMETERS, taken_by_limits};

type Both<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);

/// Torque that limits remove from the engine (N,), and the rack's share of it (N,), for measured signals.
#[pyfunction]
#[pyo3(name = "taken_by_limits")]
fn followed<'py>(
    py: Python<'py>,
    parameters: &Bound<'py, PyAny>,
    set_point: &Bound<'py, PyAny>,
    speed: &Bound<'py, PyAny>,
    torque: &Bound<'py, PyAny>,
    every: f64,
) -> PyResult<Both<'py>> {
    let parameters: Vector<'_> = borrow("parameters", parameters)?;
    let set_point: Vector<'_> = borrow("set_point", set_point)?;
    let speed: Vector<'_> = borrow("speed", speed)?;
    let torque: Vector<'_> = borrow("torque", torque)?;
    expect_shape("parameters", &[parameters.len()?], [PARAMETERS.len()], "parameters")?;
    let data = Measured {
        set_point: set_point.as_slice()?,
        speed: speed.as_slice()?,
        torque: torque.as_slice()?,
        every,
    };
    let mut numbers = [0.0; PARAMETERS.len()];
    numbers.copy_from_slice(parameters.as_slice()?);
    let [engine, rack] = guard::run(py, data.speed.len(), |stop| taken_by_limits(data, &numbers, stop))?;
    Ok((engine.into_pyarray(py), rack.into_pyarray(py)))
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("ENGINE_SIDE_PARAMETERS", PyTuple::new(module.py(), PARAMETERS)?)?;
    module.add_function(wrap_pyfunction!(followed, module)?)
}
