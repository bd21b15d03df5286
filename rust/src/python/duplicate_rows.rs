//! Bindings of the search for repeated stretches in a channel.

use numpy::{Ix1, PyArray2, PyReadonlyArray};
use pyo3::prelude::*;

use super::arrays::{borrow, hand_back};
use super::guard;
use super::streaming::Streaming;
use crate::duplicate_rows;

/// Fingerprints of a channel's samples, fed in chunks of any length; see ARCHITECTURE.md.
#[pyclass(module = "shipfp_rs._core")]
struct RepeatScan(Streaming<duplicate_rows::RepeatScan>);

#[pymethods]
impl RepeatScan {
    #[new]
    fn new() -> Self {
        Self(Streaming::new(duplicate_rows::RepeatScan::new()))
    }

    /// Take the next samples.
    fn feed(&mut self, py: Python<'_>, samples: &Bound<'_, PyAny>) -> PyResult<()> {
        let samples: PyReadonlyArray<'_, f32, Ix1> = borrow("samples", samples)?;
        let samples = samples.as_slice()?;
        self.0.run(py, samples.len(), |scan, stop| scan.feed(samples, stop))
    }

    /// Start indices and distances of runs of recurring fingerprints, int64 [C, 2].
    fn candidates<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i64>>> {
        let scan = self.0.kernel()?;
        let found = guard::run(py, 0, |_| Ok(scan.candidates()))?;
        let flat: Vec<i64> =
            found.iter().flat_map(|&(place, lag)| [place, lag]).map(u64::cast_signed).collect();
        hand_back(py, flat, [found.len(), 2])
    }
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<RepeatScan>()
}
