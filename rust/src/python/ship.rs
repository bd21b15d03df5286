//! Bindings of the ship model.

use numpy::PyArray2;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use super::arrays::{Sensitivities, Sums, Targets, Vector, borrow, filled_with_derivatives, hand_back_sums};
use super::guard;
use crate::ship::{OFF, OUTPUTS, Output, PARAMETERS, Parameters, Record, Run, Task, simulate};

/// Simulate the ship; [O, N].
#[pyfunction]
#[pyo3(signature = (parameters, u, load, dt, substeps, hold, outputs, sharp = true))]
#[allow(clippy::too_many_arguments)]
fn simulate_ship<'py>(
    py: Python<'py>,
    parameters: &Bound<'py, PyAny>,
    u: &Bound<'py, PyAny>,
    load: &Bound<'py, PyAny>,
    dt: f64,
    substeps: usize,
    hold: &str,
    outputs: Vec<usize>,
    sharp: bool,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    Ok(ship_sensitivities(py, parameters, u, load, dt, substeps, hold, outputs, vec![], sharp)?.0)
}

/// Simulated outputs [O, N] and their derivatives [W, O, N] by the parameters of index `wrt`.
#[pyfunction]
#[pyo3(signature = (parameters, u, load, dt, substeps, hold, outputs, wrt, sharp = true))]
#[allow(clippy::too_many_arguments)]
fn ship_sensitivities<'py>(
    py: Python<'py>,
    parameters: &Bound<'py, PyAny>,
    u: &Bound<'py, PyAny>,
    load: &Bound<'py, PyAny>,
    dt: f64,
    substeps: usize,
    hold: &str,
    outputs: Vec<usize>,
    wrt: Vec<usize>,
    sharp: bool,
) -> PyResult<Sensitivities<'py>> {
    let inputs = Inputs::borrow(u, load)?;
    let run = Run { sharp, ..inputs.run(dt, substeps, hold)? };
    let outputs = Output::from_indices(&outputs)?;
    let task = Task { parameters: vector(parameters)?, outputs: &outputs, wrt: &wrt };
    let shape = [wrt.len(), outputs.len(), run.samples()];
    filled_with_derivatives(py, shape, task.work(&run), |values, slopes, stop| {
        simulate(&task, &run, values, slopes, stop)
    })
}

/// Sums of products of residuals and sensitivities, filtered: ([O, W + 2, O, W + 2], samples counted). The columns of an output
/// are its derivatives by `wrt`, what an offset of it adds, and its residual.
#[pyfunction]
#[pyo3(signature = (parameters, u, load, dt, substeps, hold, outputs, measured, offsets, filters, wrt, sharp = true))]
#[allow(clippy::too_many_arguments)]
fn ship_products<'py>(
    py: Python<'py>,
    parameters: &Bound<'py, PyAny>,
    u: &Bound<'py, PyAny>,
    load: &Bound<'py, PyAny>,
    dt: f64,
    substeps: usize,
    hold: &str,
    outputs: Vec<usize>,
    measured: &Bound<'py, PyAny>,
    offsets: &Bound<'py, PyAny>,
    filters: &Bound<'py, PyAny>,
    wrt: Vec<usize>,
    sharp: bool,
) -> PyResult<Sums<'py>> {
    let inputs = Inputs::borrow(u, load)?;
    let run = Run { sharp, ..inputs.run(dt, substeps, hold)? };
    let parameters = vector(parameters)?;
    let targets = Targets::borrow(measured, offsets, filters, outputs.len(), run.samples())?;
    let rows = outputs.len();
    let record = record(run, &outputs, wrt, &targets)?;
    let sums = guard::run(py, record.work(&parameters), |stop| record.sums(&parameters, stop))?;
    hand_back_sums(py, sums.values, [rows, sums.columns], sums.count)
}

fn vector(parameters: &Bound<'_, PyAny>) -> PyResult<Parameters> {
    let vector: Vector<'_> = borrow("parameters", parameters)?;
    Ok(Parameters::new(vector.as_slice()?, "parameters")?)
}

/// The inputs of a run, borrowed from Python.
struct Inputs<'py> {
    set: Vector<'py>,
    load: Vector<'py>,
}

impl<'py> Inputs<'py> {
    fn borrow(u: &Bound<'py, PyAny>, load: &Bound<'py, PyAny>) -> PyResult<Self> {
        Ok(Self { set: borrow("u", u)?, load: borrow("load", load)? })
    }

    fn run(&self, dt: f64, substeps: usize, hold: &str) -> PyResult<Run<'_>> {
        Ok(Run::new(self.set.as_slice()?, self.load.as_slice()?, dt, substeps, hold.parse()?)?)
    }
}

fn record<'a>(
    run: Run<'a>,
    outputs: &[usize],
    wrt: Vec<usize>,
    targets: &'a Targets<'_>,
) -> PyResult<Record<'a>> {
    let (measured, offsets, filters) = targets.slices()?;
    Ok(Record::new(run, Output::from_indices(outputs)?, wrt, measured, offsets, filters)?)
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("SHIP_PARAMETERS", PyTuple::new(module.py(), PARAMETERS)?)?;
    // Values at which a parameter has no effect; not a number where there is none.
    module.add("SHIP_OFF", PyTuple::new(module.py(), OFF)?)?;
    module.add("SHIP_OUTPUTS", PyTuple::new(module.py(), OUTPUTS)?)?;
    module.add_function(wrap_pyfunction!(simulate_ship, module)?)?;
    module.add_function(wrap_pyfunction!(ship_sensitivities, module)?)?;
    module.add_function(wrap_pyfunction!(ship_products, module)?)?;
    Ok(())
}
