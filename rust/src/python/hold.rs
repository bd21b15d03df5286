//! Conversion of Python's names for the course of a set point between samples.

use pyo3::prelude::*;

use crate::error::Error;
use crate::hold::Hold;

impl FromPyObject<'_, '_> for Hold {
    type Error = PyErr;

    fn extract(hold: Borrowed<'_, '_, PyAny>) -> PyResult<Self> {
        if let Ok(name) = hold.extract::<String>() {
            return Ok(name.parse()?);
        }
        let found = hold.get_type();
        Err(Error::Invalid(format!("hold is of {found}, expected 'zero' or 'first'")).into())
    }
}
