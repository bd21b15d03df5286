//! Bindings of the filters of long channels.

use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;

use super::arrays::{Vector, borrow};
use super::guard;
use crate::filter;

/// Median of the `window` samples around each one, the signal reflected at its ends.
#[pyfunction]
fn running_median<'py>(
    py: Python<'py>,
    samples: &Bound<'py, PyAny>,
    window: usize,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let samples: Vector<'_> = borrow("samples", samples)?;
    let samples = samples.as_slice()?;
    let medians = guard::run(py, samples.len(), |stop| filter::running_median(samples, window, stop))?;
    Ok(medians.into_pyarray(py))
}

/// Resampling by `up / down` with one zero-phase filter, the input in pieces; see ARCHITECTURE.md.
#[pyclass(module = "shipfp_rs._core")]
struct Decimator(filter::Decimator);

#[pymethods]
impl Decimator {
    #[new]
    fn new(taps: &Bound<'_, PyAny>, up: usize, down: usize) -> PyResult<Self> {
        let taps: Vector<'_> = borrow("taps", taps)?;
        Ok(Self(filter::Decimator::new(taps.as_slice()?, up, down)?))
    }

    /// Outputs that the next piece completes.
    fn feed<'py>(
        &mut self,
        py: Python<'py>,
        samples: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let samples: Vector<'_> = borrow("samples", samples)?;
        let (filter, samples) = (&mut self.0, samples.as_slice()?);
        Ok(guard::run(py, samples.len(), |stop| filter.feed(samples, stop))?.into_pyarray(py))
    }

    /// The outputs that are left, `total` in all.
    fn finish<'py>(&mut self, py: Python<'py>, total: usize) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let filter = &mut self.0;
        Ok(guard::run(py, 0, |stop| filter.finish(total, stop))?.into_pyarray(py))
    }
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Decimator>()?;
    module.add_function(wrap_pyfunction!(running_median, module)?)?;
    Ok(())
}
