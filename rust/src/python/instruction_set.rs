//! Bindings by which tests select each of the machine's instruction sets.

use pyo3::prelude::*;
use pyo3::types::PyTuple;

use crate::instruction_set;

/// Names of the instruction sets that this machine supports, narrowest first.
#[pyfunction]
fn _instruction_sets(py: Python<'_>) -> PyResult<Bound<'_, PyTuple>> {
    PyTuple::new(py, instruction_set::available())
}

/// Run all kernels of this process with an instruction set from now on; None: the widest.
#[pyfunction]
#[pyo3(signature = (name))]
fn _set_instruction_set(name: Option<&str>) -> PyResult<()> {
    Ok(instruction_set::choose(name)?)
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    // The environment variable selects the set in child processes, too.
    if let Ok(name) = std::env::var("SHIPFP_INSTRUCTION_SET") {
        instruction_set::choose(Some(&name))?;
    }
    module.add_function(wrap_pyfunction!(_instruction_sets, module)?)?;
    module.add_function(wrap_pyfunction!(_set_instruction_set, module)?)?;
    Ok(())
}
