//! Bindings of the filters of long channels.

use numpy::{IntoPyArray, PyArray1, PyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::arrays::{Matrix, Vector, borrow, expect_shape, hand_back_spans};
use super::guard;
use super::streaming::Streaming;
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

/// The spikes of a signal, int64 [K, 2]: the first sample and one past the last; see ARCHITECTURE.md.
#[pyfunction]
fn find_spikes<'py>(
    py: Python<'py>,
    samples: &Bound<'py, PyAny>,
    longest: usize,
    stride: usize,
    scale_window: usize,
    threshold: f64,
    least: f64,
) -> PyResult<Bound<'py, PyArray2<i64>>> {
    let samples: Vector<'_> = borrow("samples", samples)?;
    let samples = samples.as_slice()?;
    let rule = filter::SpikeRule { longest, stride, scale_window, threshold, least };
    let spikes = guard::run(py, samples.len(), |stop| filter::find_spikes(samples, &rule, stop))?;
    hand_back_spans(py, spikes.into_iter().map(|(start, end)| (start as u64, end as u64)))
}

/// Slopes of a piecewise cubic at the times `start + k / rate` within its edges, and the first such k < `count`.
#[pyfunction]
fn slope_at_even_times<'py>(
    py: Python<'py>,
    edges: &Bound<'py, PyAny>,
    coefficients: &Bound<'py, PyAny>,
    start: f64,
    rate: f64,
    count: usize,
) -> PyResult<(usize, Bound<'py, PyArray1<f64>>)> {
    let edges: Vector<'_> = borrow("edges", edges)?;
    let coefficients: Matrix<'_> = borrow("coefficients", coefficients)?;
    let stretches = edges.len().saturating_sub(1);
    expect_shape("coefficients", coefficients.shape(), [4, stretches], "powers, stretches between edges")?;
    let (edges, coefficients) = (edges.as_slice()?, coefficients.as_slice()?);
    let (first, slopes) = guard::run(py, count, |stop| {
        filter::slope_at_even_times(edges, coefficients, start, rate, count, stop)
    })?;
    Ok((first, slopes.into_pyarray(py)))
}

/// Resampling by `up / down` with one zero-phase filter, the input in pieces; see ARCHITECTURE.md.
#[pyclass(module = "shipfp_rs._core")]
struct Decimator(Streaming<filter::Decimator>);

#[pymethods]
impl Decimator {
    #[new]
    fn new(taps: &Bound<'_, PyAny>, up: usize, down: usize) -> PyResult<Self> {
        let taps: Vector<'_> = borrow("taps", taps)?;
        Ok(Self(Streaming::new(filter::Decimator::new(taps.as_slice()?, up, down)?)))
    }

    /// Outputs that the next piece completes.
    fn feed<'py>(
        &mut self,
        py: Python<'py>,
        samples: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let samples: Vector<'_> = borrow("samples", samples)?;
        let samples = samples.as_slice()?;
        Ok(self.0.run(py, samples.len(), |filter, stop| filter.feed(samples, stop))?.into_pyarray(py))
    }

    /// Return the remaining outputs, `total` since the start; the filter then accepts no further pieces.
    fn finish<'py>(&mut self, py: Python<'py>, total: usize) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let outputs = self.0.run(py, 0, |filter, stop| filter.finish(total, stop))?;
        self.0.finish();
        Ok(outputs.into_pyarray(py))
    }
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Decimator>()?;
    module.add_function(wrap_pyfunction!(find_spikes, module)?)?;
    module.add_function(wrap_pyfunction!(running_median, module)?)?;
    module.add_function(wrap_pyfunction!(slope_at_even_times, module)?)?;
    Ok(())
}
