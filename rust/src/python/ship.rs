//! Bindings of the ship model.

use numpy::{
    PyArray1, PyArray2, PyArray3, PyArray4, PyArray5, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use super::arrays::{Vector, borrow, expect_shape, hand_back, zeros};
use super::guard;
use crate::ship::{OFF, OUTPUTS, Output, PARAMETERS, Parameters, Record, Run, Task, simulate};

type Rows<'py> = Bound<'py, PyArray2<f64>>;

/// Simulate the ship; [O, N].
#[pyfunction]
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
) -> PyResult<Rows<'py>> {
    Ok(ship_sensitivities(py, parameters, u, load, dt, substeps, hold, outputs, vec![])?.0)
}

/// Simulated outputs [O, N] and their derivatives [W, O, N] by the parameters of index `wrt`.
#[pyfunction]
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
) -> PyResult<(Rows<'py>, Bound<'py, PyArray3<f64>>)> {
    let inputs = Inputs::borrow(u, load)?;
    let run = inputs.run(dt, substeps, hold)?;
    let outputs = Output::from_indices(&outputs)?;
    let task = Task { parameters: vector(parameters)?, outputs: &outputs, wrt: &wrt };
    let (count, samples) = (outputs.len(), run.samples());
    let values: Rows<'_> = zeros(py, [count, samples])?;
    let slopes: Bound<'_, PyArray3<f64>> = zeros(py, [wrt.len(), count, samples])?;
    {
        let (mut values, mut slopes) = (values.readwrite(), slopes.readwrite());
        let (values, slopes) = (values.as_slice_mut()?, slopes.as_slice_mut()?);
        guard::run(py, task.work(&run), |stop| simulate(&task, &run, values, slopes, stop))?;
    }
    Ok((values, slopes))
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
) -> PyResult<(Bound<'py, PyArray4<f64>>, usize)> {
    let inputs = Inputs::borrow(u, load)?;
    let run = Run { sharp, ..inputs.run(dt, substeps, hold)? };
    let parameters = vector(parameters)?;
    let targets = Targets::borrow(measured, offsets, filters, outputs.len(), run.samples())?;
    let rows = outputs.len();
    let record = targets.record(run, &outputs, wrt)?;
    let sums = guard::run(py, record.work(&parameters), |stop| record.sums(&parameters, stop))?;
    Ok((hand_back(py, sums.values, [rows, sums.columns, rows, sums.columns])?, sums.count))
}

type OfMany<'py> = (Bound<'py, PyArray5<f64>>, Bound<'py, PyArray1<i64>>);

/// The same of many ships [M, 32] on so many threads, 0 for all cores: ([M, O, W + 2, O, W + 2], samples counted [M]). The sums of
/// one that diverges are infinite, and it counts no sample.
#[pyfunction]
#[allow(clippy::too_many_arguments)]
fn ship_products_batch<'py>(
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
    threads: usize,
) -> PyResult<OfMany<'py>> {
    let vectors: PyReadonlyArray2<'_, f64> = borrow("parameters", parameters)?;
    let members = vectors.shape()[0];
    expect_shape("parameters", vectors.shape(), [members, PARAMETERS.len()], "members, parameters")?;
    let ships = vectors
        .as_slice()?
        .chunks_exact(PARAMETERS.len())
        .enumerate()
        .map(|(member, vector)| Parameters::new(vector, &format!("parameters[{member}]")))
        .collect::<Result<Vec<_>, _>>()?;
    let inputs = Inputs::borrow(u, load)?;
    let run = inputs.run(dt, substeps, hold)?;
    let (rows, columns) = (outputs.len(), wrt.len() + 2);
    let targets = Targets::borrow(measured, offsets, filters, rows, run.samples())?;
    let record = targets.record(run, &outputs, wrt)?;
    let work = ships.iter().fold(0_usize, |sum, ship| sum.saturating_add(record.work(ship)));
    let sums = guard::run(py, work, |stop| record.batch(&ships, threads, stop))?;
    let counts = sums.iter().map(|sums| i64::try_from(sums.count).unwrap_or(i64::MAX)).collect();
    let values = sums.into_iter().flat_map(|sums| sums.values).collect();
    Ok((hand_back(py, values, [members, rows, columns, rows, columns])?, hand_back(py, counts, [members])?))
}

/// The same without derivatives: ([M, O, 2, O, 2], samples counted [M]).
#[pyfunction]
#[allow(clippy::too_many_arguments)]
fn ship_scatter_batch<'py>(
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
    threads: usize,
) -> PyResult<OfMany<'py>> {
    ship_products_batch(
        py,
        parameters,
        u,
        load,
        dt,
        substeps,
        hold,
        outputs,
        measured,
        offsets,
        filters,
        vec![],
        threads,
    )
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

/// What a simulation is compared to, borrowed from Python.
struct Targets<'py> {
    measured: PyReadonlyArray2<'py, f64>,
    offsets: Vector<'py>,
    filters: PyReadonlyArray2<'py, f64>,
}

impl<'py> Targets<'py> {
    fn borrow(
        measured: &Bound<'py, PyAny>,
        offsets: &Bound<'py, PyAny>,
        filters: &Bound<'py, PyAny>,
        rows: usize,
        samples: usize,
    ) -> PyResult<Self> {
        let measured: PyReadonlyArray2<'_, f64> = borrow("measured", measured)?;
        let filters: PyReadonlyArray2<'_, f64> = borrow("filters", filters)?;
        expect_shape("measured", measured.shape(), [rows, samples], "outputs, samples")?;
        expect_shape("filters", filters.shape(), [rows, filters.shape()[1]], "outputs, taps")?;
        Ok(Self { measured, offsets: borrow("offsets", offsets)?, filters })
    }

    fn record<'a>(&'a self, run: Run<'a>, outputs: &[usize], wrt: Vec<usize>) -> PyResult<Record<'a>> {
        Ok(Record::new(
            run,
            Output::from_indices(outputs)?,
            wrt,
            self.measured.as_slice()?,
            self.offsets.as_slice()?,
            self.filters.as_slice()?,
        )?)
    }
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("SHIP_PARAMETERS", PyTuple::new(module.py(), PARAMETERS)?)?;
    // Values at which a parameter has no effect; not a number where there is none.
    module.add("SHIP_OFF", PyTuple::new(module.py(), OFF)?)?;
    module.add("SHIP_OUTPUTS", PyTuple::new(module.py(), OUTPUTS)?)?;
    module.add_function(wrap_pyfunction!(simulate_ship, module)?)?;
    module.add_function(wrap_pyfunction!(ship_sensitivities, module)?)?;
    module.add_function(wrap_pyfunction!(ship_products, module)?)?;
    module.add_function(wrap_pyfunction!(ship_products_batch, module)?)?;
    module.add_function(wrap_pyfunction!(ship_scatter_batch, module)?)?;
    Ok(())
}
