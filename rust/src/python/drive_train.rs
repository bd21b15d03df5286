//! Bindings of the whole drive train.

use numpy::{PyArray1, PyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use super::arrays::{Matrix, Vector, borrow, expect_shape, filled, hand_back};
use super::guard;
use crate::drive_train::{
    DriveTrain, FLOW, PARAMETERS, Quadrants, ROWS, Run, STATES, State, Tables, flow_at, simulate,
};
use crate::error::{Error, require};
use crate::hold::Hold;
use crate::stepper::Envelope;

/// Simulate one drive train; rows `n_e`, `n_s`, `M_b`, `M_g`, `M_s`, `X_f`, `E_n`, ship speed.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
fn simulate_drive_train<'py>(
    py: Python<'py>,
    parameters: &Bound<'py, PyAny>,
    limit_speed: &Bound<'py, PyAny>,
    limit_torque: &Bound<'py, PyAny>,
    strength: &Bound<'py, PyAny>,
    quadrants: &Bound<'py, PyAny>,
    n_set: &Bound<'py, PyAny>,
    dt: f64,
    substeps: usize,
    hold: Hold,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let train = drive_train(parameters, strength, quadrants)?;
    let envelope = envelope(limit_speed, limit_torque)?;
    let n_set: Vector<'_> = borrow("n_set", n_set)?;
    let run = Run { set_speed: n_set.as_slice()?, dt, substeps, hold };
    let work = n_set.len().saturating_mul(substeps);
    filled(py, [ROWS, n_set.len()], work, |values, stop| simulate(&train, &envelope, &run, values, stop))
}

/// Rates of the state, and the governor's command, `M_b`, `M_g`, `M_s`, `X_f`, at a state, a set point and a fuel command;
/// the tests hold the equations to those of the thesis with it.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
fn _drive_train_rates<'py>(
    py: Python<'py>,
    parameters: &Bound<'py, PyAny>,
    limit_speed: &Bound<'py, PyAny>,
    limit_torque: &Bound<'py, PyAny>,
    strength: &Bound<'py, PyAny>,
    quadrants: &Bound<'py, PyAny>,
    state: &Bound<'py, PyAny>,
    n_set: f64,
    fuel: f64,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let train = drive_train(parameters, strength, quadrants)?;
    let envelope = envelope(limit_speed, limit_torque)?;
    let state: Vector<'_> = borrow("state", state)?;
    let Ok(entries) = <[f64; STATES]>::try_from(state.as_slice()?) else {
        return Err(Error::Invalid(format!("state has {} values, expected {STATES}", state.len())).into());
    };
    for (name, value) in [("n_set", n_set), ("fuel", fuel)] {
        require(value.is_finite(), || format!("{name} is {value}, expected a finite number"))?;
    }
    require(entries.iter().all(|entry| entry.is_finite()), || {
        format!("state is {entries:?}, expected finite numbers")
    })?;
    let flow =
        guard::run(py, 1, |_| Ok(flow_at(&train, &envelope, &State::from_array(entries), n_set, fuel)))?;
    hand_back(py, flow.to_vec(), [STATES + FLOW])
}

fn envelope(speed: &Bound<'_, PyAny>, torque: &Bound<'_, PyAny>) -> PyResult<Envelope> {
    let speed: Vector<'_> = borrow("limit_speed", speed)?;
    let torque: Vector<'_> = borrow("limit_torque", torque)?;
    Ok(Envelope::new(speed.as_slice()?, torque.as_slice()?)?)
}

fn drive_train(
    parameters: &Bound<'_, PyAny>,
    strength: &Bound<'_, PyAny>,
    quadrants: &Bound<'_, PyAny>,
) -> PyResult<DriveTrain> {
    let parameters: Vector<'_> = borrow("parameters", parameters)?;
    Ok(DriveTrain::from_parameters(parameters.as_slice()?, tables(strength, quadrants)?)?)
}

fn tables(strength: &Bound<'_, PyAny>, quadrants: &Bound<'_, PyAny>) -> PyResult<Tables> {
    let strength: Vector<'_> = borrow("strength", strength)?;
    let quadrants: Matrix<'_> = borrow("quadrants", quadrants)?;
    let points = quadrants.shape()[1];
    expect_shape("quadrants", quadrants.shape(), [3, points], "angle, torque, thrust; points")?;
    let rows = quadrants.as_slice()?;
    Ok(Tables {
        strength: strength.as_slice()?.to_vec(),
        quadrants: Quadrants::new(&rows[..points], &rows[points..2 * points], &rows[2 * points..])?,
    })
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("DRIVE_TRAIN_PARAMETERS", PyTuple::new(module.py(), PARAMETERS)?)?;
    module.add_function(wrap_pyfunction!(simulate_drive_train, module)?)?;
    module.add_function(wrap_pyfunction!(_drive_train_rates, module)?)?;
    Ok(())
}
