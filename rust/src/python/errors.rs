//! Conversion of kernel errors to Python exceptions.

use pyo3::exceptions::{PyKeyboardInterrupt, PyMemoryError, PyRuntimeError};
use pyo3::prelude::*;

use crate::error::Error;

/// Exception of a class in `shipfp_rs.errors`.
fn package_error(class: &str, message: String) -> PyErr {
    Python::attach(|py| {
        let instance = py
            .import("shipfp_rs.errors")
            .and_then(|errors| errors.getattr(class))
            .and_then(|class| class.call1((message.clone(),)));
        match instance {
            Ok(value) => PyErr::from_value(value),
            Err(_) => PyRuntimeError::new_err(message),
        }
    })
}

impl From<Error> for PyErr {
    fn from(error: Error) -> Self {
        match error {
            Error::Invalid(message) => package_error("InputError", message),
            Error::Diverged { .. } | Error::Unstable => package_error("SimulationError", error.to_string()),
            Error::Memory { .. } => PyMemoryError::new_err(error.to_string()),
            Error::Stopped => PyKeyboardInterrupt::new_err(()),
            Error::Internal(_) => package_error("InternalError", error.to_string()),
        }
    }
}
