//! Bindings of the pulse kernels.

use numpy::{IntoPyArray, Ix1, PyArray1, PyArray2, PyReadonlyArray1};
use pyo3::prelude::*;

use super::arrays::{Vector, borrow, filled, hand_back, hand_back_spans};
use super::guard;
use crate::error::{Error, Result};
use crate::pulse;
use crate::stop::Stop;

/// Samples of any type that loggers store, borrowed.
enum Samples<'py> {
    Float32(PyReadonlyArray1<'py, f32>),
    Float64(PyReadonlyArray1<'py, f64>),
    Int16(PyReadonlyArray1<'py, i16>),
}

impl<'py> Samples<'py> {
    fn borrow(array: &Bound<'py, PyAny>) -> PyResult<Self> {
        if array.cast::<PyArray1<f32>>().is_ok() {
            Ok(Self::Float32(borrow("samples", array)?))
        } else if array.cast::<PyArray1<i16>>().is_ok() {
            Ok(Self::Int16(borrow("samples", array)?))
        } else if array.cast::<PyArray1<f64>>().is_ok() {
            Ok(Self::Float64(borrow("samples", array)?))
        } else {
            let found = array.get_type();
            let found = match (array.getattr("dtype"), array.getattr("shape")) {
                (Ok(dtype), Ok(shape)) => format!("{dtype} of shape {shape}"),
                _ => found.to_string(),
            };
            let expected = "expected one axis of float32, float64 or int16";
            Err(Error::Invalid(format!("samples: found {found}, {expected}")).into())
        }
    }
}

/// Call the generic `$kernel(samples, stop)` under the guard, for the type of these samples.
macro_rules! run_on {
    ($py:expr, $samples:expr, $kernel:expr) => {
        match &$samples {
            Samples::Float32(array) => run_slice($py, array.as_slice()?, $kernel),
            Samples::Float64(array) => run_slice($py, array.as_slice()?, $kernel),
            Samples::Int16(array) => run_slice($py, array.as_slice()?, $kernel),
        }
    };
}

fn run_slice<T: Sync, R: Send>(
    py: Python<'_>,
    samples: &[T],
    kernel: impl FnOnce(&[T], &Stop) -> Result<R> + Send,
) -> PyResult<R> {
    guard::run(py, samples.len(), |stop| kernel(samples, stop))
}

/// Crossings of one or several windows and their statistics, as `PulseTracker.cross` returns them.
type Crossed<'py> = (
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
);

fn crossed(py: Python<'_>, record: pulse::Record) -> PyResult<Crossed<'_>> {
    let (levels, windows) = (record.levels.len(), record.windows.len());
    Ok((
        record.times.into_pyarray(py),
        record.heights.into_pyarray(py),
        record.timing.grid.into_pyarray(py),
        record.timing.noise.into_pyarray(py),
        hand_back(py, record.levels.into_flattened(), [levels, 3])?,
        hand_back(py, record.windows.into_flattened(), [windows, 4])?,
    ))
}

/// Pulses of a train whose levels change. `look` estimates the levels of a window; `cross` detects the crossings of the
/// oldest window, after `look` has processed the next one.
#[pyclass(module = "shipfp_rs._core")]
struct PulseTracker(pulse::PulseTracker);

#[pymethods]
impl PulseTracker {
    #[new]
    #[pyo3(signature = (threshold=None, hysteresis=None))]
    fn new(threshold: Option<f64>, hysteresis: Option<f64>) -> PyResult<Self> {
        Ok(Self(pulse::PulseTracker::new(threshold, hysteresis)?))
    }

    /// Estimate the levels of the next window.
    fn look(&mut self, py: Python<'_>, samples: &Bound<'_, PyAny>) -> PyResult<()> {
        let samples = Samples::borrow(samples)?;
        let tracker = &mut self.0;
        run_on!(py, samples, |slice, stop| tracker.look(slice, stop))
    }

    /// Crossings of the oldest window with estimated levels: times, heights, standard deviations of the times from
    /// sampling and from noise (times in samples); levels (low, high, middle) [K, 3]; and, for the window, the number of
    /// crossings, the height above which a pulse can't be noise, and least and median height [1, 4].
    fn cross<'py>(&mut self, py: Python<'py>, samples: &Bound<'py, PyAny>) -> PyResult<Crossed<'py>> {
        let samples = Samples::borrow(samples)?;
        let tracker = &mut self.0;
        let pulses = run_on!(py, samples, |slice, stop| tracker.cross(slice, stop))?;
        let mut record = pulse::Record::default();
        record.push(pulses);
        crossed(py, record)
    }

    /// Results of `look` and `cross` for a whole record, cut into windows.
    fn follow<'py>(
        &mut self,
        py: Python<'py>,
        samples: &Bound<'py, PyAny>,
        window: usize,
    ) -> PyResult<Crossed<'py>> {
        let samples = Samples::borrow(samples)?;
        let tracker = &mut self.0;
        let record = run_on!(py, samples, |slice, stop| tracker.follow(slice, window, stop))?;
        crossed(py, record)
    }

    /// Stretches of missing samples so far, int64 [G, 2]: the first sample and the one past the last.
    #[getter]
    fn gaps<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i64>>> {
        hand_back_spans(py, self.0.gaps())
    }
}

/// Low and high state level of a pulse train, from histograms of its finite samples.
#[pyfunction]
fn pulse_levels(py: Python<'_>, samples: &Bound<'_, PyAny>) -> PyResult<(f64, f64)> {
    let samples = Samples::borrow(samples)?;
    run_on!(py, samples, pulse::pulse_levels)
}

/// Whether every period between times is at least `least` and below `most` times each of the ten periods before and
/// after.
#[pyfunction]
fn pulses_are_even(py: Python<'_>, times: &Bound<'_, PyAny>, least: f64, most: f64) -> PyResult<bool> {
    let times: Vector<'_> = borrow("times", times)?;
    let times = times.as_slice()?;
    guard::run(py, times.len(), |stop| pulse::is_even(times, least, most, stop))
}

/// Statistics of the intervals between pulses [6, N]: middle, speed, its standard deviation, length, angle, and standard
/// deviation for independent errors of the ends.
#[pyfunction]
#[allow(clippy::too_many_arguments)] // one for each column
fn interval_speeds<'py>(
    py: Python<'py>,
    edges: &Bound<'py, PyAny>,
    count: &Bound<'py, PyAny>,
    fractions: &Bound<'py, PyAny>,
    relative: &Bound<'py, PyAny>,
    noise: &Bound<'py, PyAny>,
    grid: &Bound<'py, PyAny>,
    sample: f64,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let count: PyReadonlyArray1<'_, i64> = borrow("count", count)?;
    let [edges, fractions, relative, noise, grid] = [
        ("edges", edges),
        ("fractions", fractions),
        ("relative", relative),
        ("noise", noise),
        ("grid", grid),
    ]
    .map(|(name, array)| borrow::<f64, Ix1>(name, array));
    let (edges, fractions, relative, noise, grid) = (edges?, fractions?, relative?, noise?, grid?);
    let track = pulse::Counted {
        edges: edges.as_slice()?,
        count: count.as_slice()?,
        fractions: fractions.as_slice()?,
        relative: relative.as_slice()?,
        noise: noise.as_slice()?,
        grid: grid.as_slice()?,
        sample,
    };
    let rows = track
        .count
        .iter()
        .fold(0, |sum: usize, &count| sum.saturating_add(usize::try_from(count).unwrap_or(0).min(1 << 20)));
    filled(py, [pulse::COLUMNS, rows], rows, |values, stop| {
        let mut parts = values.chunks_mut(rows.max(1));
        let columns = std::array::from_fn(|_| parts.next().unwrap_or_default());
        pulse::interval_speeds(&track, columns, stop)
    })
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PulseTracker>()?;
    module.add_function(wrap_pyfunction!(interval_speeds, module)?)?;
    module.add_function(wrap_pyfunction!(pulse_levels, module)?)?;
    module.add_function(wrap_pyfunction!(pulses_are_even, module)?)?;
    Ok(())
}
