//! Bindings of the drive train with its derivatives.

use numpy::PyUntypedArrayMethods;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use super::arrays::{
    Matrix, Sensitivities, Sums, Targets, Vector, borrow, expect_shape, filled_with_derivatives,
    hand_back_sums,
};
use super::drive_train::tables;
use super::guard;
use super::plant::envelope;
use crate::drive_train::{PARAMETERS, Run};
use crate::integrate::Hold;
use crate::sensitivity::{OUTPUTS, Output, Record, Subject, simulate};

/// Simulated outputs [O, N] and their derivatives [W, O, N] in the directions [W, P] of the parameter vector.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
fn drive_train_sensitivities<'py>(
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
    outputs: Vec<usize>,
    directions: &Bound<'py, PyAny>,
) -> PyResult<Sensitivities<'py>> {
    let subject = subject(parameters, limit_speed, limit_torque, strength, quadrants, directions)?;
    let n_set: Vector<'_> = borrow("n_set", n_set)?;
    let run = Run { set_speed: n_set.as_slice()?, dt, substeps, hold };
    let outputs = Output::from_indices(&outputs)?;
    let shape = [subject.directions(), outputs.len(), n_set.len()];
    filled_with_derivatives(py, shape, work(&subject, &run), |values, slopes, stop| {
        simulate(&subject, &run, &outputs, values, slopes, stop)
    })
}

/// Sums of products of residuals and sensitivities, filtered: ([O, W + 2, O, W + 2], samples counted), for outputs that
/// are `scale` times the simulated ones plus `offsets`. The columns of an output are its derivatives in the directions,
/// what an offset of it adds, and its residual.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
fn drive_train_products<'py>(
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
    outputs: Vec<usize>,
    directions: &Bound<'py, PyAny>,
    scale: &Bound<'py, PyAny>,
    measured: &Bound<'py, PyAny>,
    offsets: &Bound<'py, PyAny>,
    filters: &Bound<'py, PyAny>,
) -> PyResult<Sums<'py>> {
    let subject = subject(parameters, limit_speed, limit_torque, strength, quadrants, directions)?;
    let n_set: Vector<'_> = borrow("n_set", n_set)?;
    let run = Run { set_speed: n_set.as_slice()?, dt, substeps, hold };
    let rows = outputs.len();
    let scale: Vector<'_> = borrow("scale", scale)?;
    let targets = Targets::borrow(measured, offsets, filters, rows, n_set.len())?;
    let (measured, offsets, filters) = targets.slices()?;
    let outputs = Output::from_indices(&outputs)?;
    let record = Record::new(run, outputs, scale.as_slice()?, offsets, measured, filters)?;
    let sums = guard::run(py, work(&subject, &run), |stop| record.sums(&subject, stop))?;
    hand_back_sums(py, sums.values, [rows, sums.columns], sums.count)
}

fn subject(
    parameters: &Bound<'_, PyAny>,
    limit_speed: &Bound<'_, PyAny>,
    limit_torque: &Bound<'_, PyAny>,
    strength: &Bound<'_, PyAny>,
    quadrants: &Bound<'_, PyAny>,
    directions: &Bound<'_, PyAny>,
) -> PyResult<Subject> {
    let parameters: Vector<'_> = borrow("parameters", parameters)?;
    let directions: Matrix<'_> = borrow("directions", directions)?;
    expect_shape(
        "directions",
        directions.shape(),
        [directions.shape()[0], PARAMETERS.len()],
        "directions, parameters",
    )?;
    let envelope = envelope(limit_speed, limit_torque)?;
    let tables = tables(strength, quadrants)?;
    Ok(Subject::new(parameters.as_slice()?, directions.as_slice()?, envelope, tables)?)
}

/// Steps, each with its derivatives.
fn work(subject: &Subject, run: &Run<'_>) -> usize {
    run.set_speed.len().saturating_mul(run.substeps).saturating_mul(1 + subject.directions())
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("GREY_BOX_OUTPUTS", PyTuple::new(module.py(), OUTPUTS)?)?;
    module.add_function(wrap_pyfunction!(drive_train_sensitivities, module)?)?;
    module.add_function(wrap_pyfunction!(drive_train_products, module)?)?;
    Ok(())
}
