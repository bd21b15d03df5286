//! Runs a kernel without the interpreter: Ctrl-C stops it, and a panic becomes an ordinary exception.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use pyo3::prelude::*;

use crate::error::{Error, Result};
use crate::stop::Stop;

/// Number of state updates below which a kernel takes well under a second and needs no watcher.
const WATCH_FROM: usize = 4_000_000;
const LOOK_EVERY: Duration = Duration::from_millis(50);

fn describe(panic: &(dyn Any + Send)) -> String {
    panic
        .downcast_ref::<&str>()
        .map(ToString::to_string)
        .or_else(|| panic.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "panic without a message".to_owned())
}

fn caught<T>(kernel: impl FnOnce() -> Result<T>) -> Result<T> {
    catch_unwind(AssertUnwindSafe(kernel)).unwrap_or_else(|panic| Err(Error::Internal(describe(&*panic))))
}

// A closure, since `Python::check_signals` itself is not generic over the lifetime.
#[allow(clippy::redundant_closure_for_method_calls)]
/// Run `kernel` detached; `work` is the approximate number of the kernel's inner steps.
///
/// Long work runs on another thread while this one checks for signals, since Python handles signals only on the calling
/// thread.
pub fn run<T: Send>(
    py: Python<'_>,
    work: usize,
    kernel: impl FnOnce(&Stop) -> Result<T> + Send,
) -> PyResult<T> {
    let stop = Stop::new();
    if work < WATCH_FROM {
        return Ok(py.detach(|| caught(|| kernel(&stop)))?);
    }
    py.detach(|| {
        std::thread::scope(|scope| {
            let (done, result) = channel();
            let flag = &stop;
            std::thread::Builder::new()
                .spawn_scoped(scope, move || done.send(caught(|| kernel(flag))))
                .map_err(|error| Error::Internal(format!("can't start a thread: {error}")))?;
            let mut signal = None;
            loop {
                match result.recv_timeout(LOOK_EVERY) {
                    Ok(outcome) => break signal.map_or_else(|| outcome.map_err(PyErr::from), Err),
                    Err(RecvTimeoutError::Timeout) => {
                        if signal.is_none()
                            && let Err(raised) = Python::attach(|py| py.check_signals())
                        {
                            stop.request();
                            signal = Some(raised);
                        }
                    }
                    Err(RecvTimeoutError::Disconnected) => {
                        break Err(
                            Error::Internal("a kernel's thread ended without a result".to_owned()).into()
                        );
                    }
                }
            }
        })
    })
}

/// Panic inside a guarded kernel; the tests use it to see that a panic reaches Python as `InternalError`.
#[pyfunction]
fn _panic_for_test(py: Python<'_>, message: &str) -> PyResult<()> {
    let message = message.to_owned();
    run(py, 0, move |_| panic!("{message}"))
}

/// Work until stopped; the tests use it to see that Ctrl-C ends a kernel.
#[pyfunction]
fn _spin_for_test(py: Python<'_>) -> PyResult<()> {
    run(py, usize::MAX, |stop| {
        loop {
            stop.check()?;
            std::thread::sleep(Duration::from_millis(1));
        }
    })
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(_panic_for_test, module)?)?;
    module.add_function(wrap_pyfunction!(_spin_for_test, module)?)?;
    Ok(())
}
