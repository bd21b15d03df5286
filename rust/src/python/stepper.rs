//! Bindings of the ship.

use numpy::{PyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use super::arrays::{Matrix, Vector, borrow, expect_shape, filled};
use crate::hold::Hold;
use crate::stepper::{
    DETAIL, Detail, Envelope, OFF, OUTPUTS, Output, PARAMETERS, Parameters, Run, simulate,
    simulate_explicitly,
};

/// Simulate the ship; `envelope` [2, K] is the highest torque by speed. Returns the outputs [O, N].
#[pyfunction]
#[pyo3(signature = (parameters, u, load, dt, substeps, hold, outputs, envelope=None))]
#[allow(clippy::too_many_arguments)]
fn simulate_ship<'py>(
    py: Python<'py>,
    parameters: &Bound<'py, PyAny>,
    u: &Bound<'py, PyAny>,
    load: &Bound<'py, PyAny>,
    dt: f64,
    substeps: usize,
    hold: Hold,
    outputs: Vec<usize>,
    envelope: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let parameters = vector(parameters)?;
    let (u, load): (Vector<'_>, Vector<'_>) = (borrow("u", u)?, borrow("load", load)?);
    let substeps = if substeps == 0 { parameters.substeps(dt) } else { substeps };
    let run = Run::new(u.as_slice()?, load.as_slice()?, dt, substeps, hold)?;
    let envelope = limit(envelope.as_ref())?;
    let run = run.below(&envelope);
    let outputs = Output::from_indices(&outputs)?;
    filled(py, [outputs.len(), run.set.len()], run.work(), |rows, stop| {
        simulate(&parameters, &run, &outputs, rows, stop)
    })
}

/// Simulate a ship whose only states are speed and integral, by an explicit method. Returns the outputs [O, N].
#[pyfunction]
#[pyo3(signature = (parameters, u, dt, substeps, method, hold, initial, outputs, envelope=None))]
#[allow(clippy::too_many_arguments)]
fn simulate_ship_by<'py>(
    py: Python<'py>,
    parameters: &Bound<'py, PyAny>,
    u: &Bound<'py, PyAny>,
    dt: f64,
    substeps: usize,
    method: &str,
    hold: Hold,
    initial: &Bound<'py, PyAny>,
    outputs: Vec<usize>,
    envelope: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let parameters = vector(parameters)?;
    let (u, initial): (Vector<'_>, Vector<'_>) = (borrow("u", u)?, borrow("initial", initial)?);
    let (limit, method) = (limit(envelope.as_ref())?, method.parse()?);
    let run = Run::new(u.as_slice()?, &[], dt, substeps, hold)?.below(&limit);
    let (outputs, initial) = (Output::from_indices(&outputs)?, initial.as_slice()?);
    filled(py, [outputs.len(), run.set.len()], run.work(), |rows, stop| {
        simulate_explicitly(&parameters, &run, method, initial, &outputs, rows, stop)
    })
}

/// Simulate a ship with the additional elements of a whole drive train. Returns the outputs [O, N].
#[pyfunction]
#[pyo3(signature = (parameters, detail, strength, quadrants, u, dt, substeps, hold, outputs, envelope=None))]
#[allow(clippy::too_many_arguments)]
fn simulate_detailed_ship<'py>(
    py: Python<'py>,
    parameters: &Bound<'py, PyAny>,
    detail: &Bound<'py, PyAny>,
    strength: &Bound<'py, PyAny>,
    quadrants: &Bound<'py, PyAny>,
    u: &Bound<'py, PyAny>,
    dt: f64,
    substeps: usize,
    hold: Hold,
    outputs: Vec<usize>,
    envelope: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let parameters = vector(parameters)?;
    let (u, detail): (Vector<'_>, Vector<'_>) = (borrow("u", u)?, borrow("detail", detail)?);
    let (strength, table): (Vector<'_>, Matrix<'_>) =
        (borrow("strength", strength)?, borrow("quadrants", quadrants)?);
    let count = table.shape()[1];
    expect_shape("quadrants", table.shape(), [3, count], "angle, torque, thrust; points")?;
    let rows = table.as_slice()?;
    let of = |row: usize| Envelope::new(&rows[..count], &rows[row * count..(row + 1) * count]);
    let quadrants = if count == 0 { None } else { Some([of(1)?, of(2)?]) };
    let detail = Detail::new(detail.as_slice()?, strength.as_slice()?, quadrants)?;
    let envelope = limit(envelope.as_ref())?;
    let run = Run::new(u.as_slice()?, &[], dt, substeps, hold)?.below(&envelope);
    let run = Run { detail: Some(&detail), ..run };
    let outputs = Output::from_indices(&outputs)?;
    filled(py, [outputs.len(), run.set.len()], run.work(), |rows, stop| {
        simulate(&parameters, &run, &outputs, rows, stop)
    })
}

/// Rows of speeds and of torques; without points there is no limit.
fn limit(envelope: Option<&Bound<'_, PyAny>>) -> PyResult<Envelope> {
    let Some(envelope) = envelope else { return Ok(Envelope::new(&[], &[])?) };
    let points: Matrix<'_> = borrow("envelope", envelope)?;
    let count = points.shape()[1];
    expect_shape("envelope", points.shape(), [2, count], "speed, torque; points")?;
    let (speed, torque) = points.as_slice()?.split_at(count);
    Ok(Envelope::new(speed, torque)?)
}

fn vector(parameters: &Bound<'_, PyAny>) -> PyResult<Parameters> {
    let vector: Vector<'_> = borrow("parameters", parameters)?;
    Ok(Parameters::new(vector.as_slice()?, "parameters")?)
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("SHIP_PARAMETERS", PyTuple::new(module.py(), PARAMETERS)?)?;
    // Values at which a parameter has no effect; NaN if there is no such value.
    module.add("SHIP_OFF", PyTuple::new(module.py(), OFF)?)?;
    module.add("SHIP_DETAIL", PyTuple::new(module.py(), DETAIL)?)?;
    module.add("SHIP_OUTPUTS", PyTuple::new(module.py(), OUTPUTS)?)?;
    module.add_function(wrap_pyfunction!(simulate_ship, module)?)?;
    module.add_function(wrap_pyfunction!(simulate_ship_by, module)?)?;
    module.add_function(wrap_pyfunction!(simulate_detailed_ship, module)?)?;
    Ok(())
}
