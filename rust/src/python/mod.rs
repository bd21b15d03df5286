//! The bindings: the only files that know Python. Each function checks, borrows, detaches, computes, hands back.

// A `#[pyfunction]` takes its arguments by value: the macro's signature, not ours.
#![allow(clippy::needless_pass_by_value)]

mod arrays;
mod drive_train;
mod errors;
mod filter;
mod guard;
mod leftover;
mod linear;
mod plant;
mod pulse;
mod pyramid;
mod repeats;
mod sensitivity;
mod ship;
mod statespace;

use pyo3::prelude::*;

/// Compiled kernels of `shipfp_rs`; use them through the package's own modules.
#[pymodule(gil_used = false)]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    drive_train::register(module)?;
    filter::register(module)?;
    guard::register(module)?;
    leftover::register(module)?;
    linear::register(module)?;
    plant::register(module)?;
    pulse::register(module)?;
    pyramid::register(module)?;
    repeats::register(module)?;
    sensitivity::register(module)?;
    ship::register(module)?;
    statespace::register(module)?;
    Ok(())
}
