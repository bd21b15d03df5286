//! Bindings of the plant kernels.

use numpy::{PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use super::arrays::{Vector, borrow};
use super::guard;
use crate::error::require;
use crate::integrate::{ROWS, Scheme, simulate, simulate_batch};
use crate::plant::{Envelope, PARAMETERS, Plant};

#[pyfunction]
#[pyo3(name = "simulate_plant")]
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
    hold: &str,
    initial: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let parameters: Vector<'_> = borrow("parameters", parameters)?;
    let plant = Plant::from_parameters(parameters.as_slice()?, "parameters")?;
    let envelope = envelope(limit_speed, limit_torque)?;
    let scheme = Scheme::new(dt, substeps, method.parse()?, hold.parse()?)?;
    let set_speed: Vector<'_> = borrow("n_set", n_set)?;
    let initial: Vector<'_> = borrow("initial", initial)?;
    let samples = set_speed.len();
    let output = PyArray2::zeros(py, [ROWS, samples], false);
    {
        let mut output = output.readwrite();
        let (values, start, rows) = (set_speed.as_slice()?, initial.as_slice()?, output.as_slice_mut()?);
        guard::run(py, scheme.steps(samples), |stop| {
            simulate(&plant, &envelope, values, &scheme, start, rows, stop)
        })?;
    }
    Ok(output)
}

#[pyfunction]
#[pyo3(name = "simulate_plant_batch")]
#[allow(clippy::too_many_arguments)]
fn simulate_plant_batch<'py>(
    py: Python<'py>,
    parameters: &Bound<'py, PyAny>,
    limit_speed: &Bound<'py, PyAny>,
    limit_torque: &Bound<'py, PyAny>,
    n_set: &Bound<'py, PyAny>,
    dt: f64,
    substeps: usize,
    method: &str,
    hold: &str,
    initial: &Bound<'py, PyAny>,
    threads: usize,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let parameters: PyReadonlyArray2<'_, f64> = borrow("parameters", parameters)?;
    let envelope = envelope(limit_speed, limit_torque)?;
    let scheme = Scheme::new(dt, substeps, method.parse()?, hold.parse()?)?;
    let set_speed: PyReadonlyArray2<'_, f64> = borrow("n_set", n_set)?;
    let initial: PyReadonlyArray2<'_, f64> = borrow("initial", initial)?;
    let (members, width) = (parameters.shape()[0], parameters.shape()[1]);
    let (rows, samples) = (set_speed.shape()[0], set_speed.shape()[1]);
    let shaped = |ok: bool, name: &str, found: &[usize], expected: String| {
        require(ok, || format!("{name} has shape {found:?}, expected {expected}"))
    };
    shaped(
        width == PARAMETERS.len(),
        "parameters",
        parameters.shape(),
        format!("[members, {}]", PARAMETERS.len()),
    )?;
    shaped(
        rows == 1 || rows == members,
        "n_set",
        set_speed.shape(),
        format!("[1, samples] or [{members}, samples]"),
    )?;
    shaped(initial.shape() == [members, 2], "initial", initial.shape(), format!("[{members}, 2]"))?;
    let output = PyArray3::zeros(py, [members, ROWS, samples], false);
    {
        let mut output = output.readwrite();
        let (vectors, values, start) = (parameters.as_slice()?, set_speed.as_slice()?, initial.as_slice()?);
        let results = output.as_slice_mut()?;
        guard::run(py, scheme.steps(samples).saturating_mul(members), |stop| {
            simulate_batch(vectors, &envelope, values, samples, &scheme, start, threads, results, stop)
        })?;
    }
    Ok(output)
}

fn envelope(speed: &Bound<'_, PyAny>, torque: &Bound<'_, PyAny>) -> PyResult<Envelope> {
    let speed: Vector<'_> = borrow("limit_speed", speed)?;
    let torque: Vector<'_> = borrow("limit_torque", torque)?;
    Ok(Envelope::new(speed.as_slice()?, torque.as_slice()?)?)
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("PLANT_PARAMETERS", PyTuple::new(module.py(), PARAMETERS)?)?;
    module.add_function(wrap_pyfunction!(simulate_plant, module)?)?;
    module.add_function(wrap_pyfunction!(simulate_plant_batch, module)?)?;
    Ok(())
}
