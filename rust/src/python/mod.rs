//! The bindings: the only files that depend on Python. Each function checks and borrows its arguments, releases the
//! interpreter, computes, and returns arrays.

// `#[pyfunction]` requires arguments by value.
#![allow(clippy::needless_pass_by_value)]

mod arrays;
mod engine_side;
mod errors;
mod guard;
mod hold;
mod instruction_set;
mod pulse;
mod statespace;
mod stepper;
mod two_equations;

use pyo3::prelude::*;

/// Compiled kernels of `shipfp_rs`; use them through the package's own modules.
#[pymodule(gil_used = false)]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    guard::register(module)?;
    instruction_set::register(module)?;
    pulse::register(module)?;
    engine_side::register(module)?;
    statespace::register(module)?;
    stepper::register(module)?;
    two_equations::register(module)?;
    Ok(())
}
