//! Bindings of the min/max pyramid.

use numpy::{Ix2, PyArray2, PyReadonlyArray};
use pyo3::prelude::*;

use super::arrays::{borrow, hand_back, hand_back_spans};
use super::guard;
use super::pulse::{Samples, run_on};
use crate::pyramid;

/// Least and greatest finite sample of blocks of a channel that comes in chunks; see ARCHITECTURE.md.
#[pyclass(module = "shipfp_rs._core")]
struct Extremes(pyramid::Extremes);

fn pairs_of(py: Python<'_>, pairs: Vec<[f64; 2]>) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let count = pairs.len();
    hand_back(py, pairs.into_flattened(), [count, 2])
}

#[pymethods]
impl Extremes {
    #[new]
    fn new(block: usize) -> PyResult<Self> {
        Ok(Self(pyramid::Extremes::new(block)?))
    }

    /// Blocks that the next samples complete, float64 [K, 2]: least and greatest, NaN where none is finite.
    fn feed<'py>(
        &mut self,
        py: Python<'py>,
        samples: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let samples = Samples::borrow(samples)?;
        let extremes = &mut self.0;
        let pairs = run_on!(py, samples, |slice, stop| extremes.feed(slice, stop))?;
        pairs_of(py, pairs)
    }

    /// The last, incomplete block, if any, float64 [0 or 1, 2].
    fn finish<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        pairs_of(py, self.0.finish().into_iter().collect())
    }

    /// Samples seen so far.
    #[getter]
    const fn seen(&self) -> u64 {
        self.0.seen()
    }

    /// The first stretches of missing samples, int64 [G, 2]: the first sample and the one past the last.
    #[getter]
    fn gaps<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i64>>> {
        hand_back_spans(py, self.0.gaps().spans())
    }

    /// Number of all stretches of missing samples.
    #[getter]
    fn gap_count(&self) -> u64 {
        self.0.gaps().count()
    }
}

/// Least and greatest value of every `factor` rows, float64 [ceil(K / factor), 2].
#[pyfunction]
fn coarser_extremes<'py>(
    py: Python<'py>,
    pairs: &Bound<'py, PyAny>,
    factor: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let pairs: PyReadonlyArray<'_, f64, Ix2> = borrow("pairs", pairs)?;
    let columns = pairs.as_array().ncols();
    if columns != 2 {
        let message = format!("pairs: found {columns} columns, expected 2");
        return Err(crate::error::Error::Invalid(message).into());
    }
    let (flat, _) = pairs.as_slice()?.as_chunks::<2>();
    let found = guard::run(py, flat.len(), |stop| pyramid::coarser(flat, factor, stop))?;
    pairs_of(py, found)
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Extremes>()?;
    module.add_function(wrap_pyfunction!(coarser_extremes, module)?)?;
    Ok(())
}
