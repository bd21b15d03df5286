//! Course of a set point between samples.

use std::str::FromStr;

use crate::error::{Error, Result};

/// Course of the set point between samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hold {
    /// Constant until the next sample.
    Zero,
    /// Linear to the next sample.
    First,
}

impl FromStr for Hold {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        match name {
            "zero" => Ok(Self::Zero),
            "first" => Ok(Self::First),
            _ => Err(Error::Invalid(format!("hold is '{name}', expected 'zero' or 'first'"))),
        }
    }
}
