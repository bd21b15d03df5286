//! Bindings through which the tests go through the instruction sets of the machine.

use pyo3::prelude::*;
use pyo3::types::PyTuple;

use crate::instruction_set;

/// Names of the instruction sets that this machine has, from the narrowest on.
#[pyfunction]
fn _instruction_sets(py: Python<'_>) -> PyResult<Bound<'_, PyTuple>> {
    PyTuple::new(py, instruction_set::available())
}

/// Run all kernels of this process with that instruction set from now on; None for the widest again.
#[pyfunction]
#[pyo3(signature = (name))]
fn _set_instruction_set(name: Option<&str>) -> PyResult<()> {
    Ok(instruction_set::choose(name)?)
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    // Child processes, too, compute as a machine without the wider sets would.
    if let Ok(name) = std::env::var("SHIPFP_INSTRUCTION_SET") {
        instruction_set::choose(Some(&name))?;
    }
    module.add_function(wrap_pyfunction!(_instruction_sets, module)?)?;
    module.add_function(wrap_pyfunction!(_set_instruction_set, module)?)?;
    Ok(())
}
