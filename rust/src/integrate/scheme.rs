//! How a simulation steps through time.

use std::str::FromStr;

use crate::error::{Error, Result, require};

/// Names of the methods.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MethodName {
    /// Forward Euler.
    Euler,
    /// Explicit trapezoid.
    Heun,
    /// Classical fourth-order Runge-Kutta.
    Rk4,
}

impl FromStr for MethodName {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        match name {
            "euler" => Ok(Self::Euler),
            "heun" => Ok(Self::Heun),
            "rk4" => Ok(Self::Rk4),
            _ => Err(Error::Invalid(format!("method is '{name}', expected 'rk4', 'heun' or 'euler'"))),
        }
    }
}

/// How the set point runs between samples.
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

/// Sample time, steps a sample, method and hold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scheme {
    pub(super) dt: f64,
    pub(super) substeps: usize,
    pub(super) method: MethodName,
    pub(super) hold: Hold,
}

impl Scheme {
    /// Check and collect; `dt` is the sample time [s].
    ///
    /// # Errors
    /// Where `dt` is not positive or `substeps` is zero.
    pub fn new(dt: f64, substeps: usize, method: MethodName, hold: Hold) -> Result<Self> {
        require(dt.is_finite() && dt > 0.0, || format!("dt is {dt}, expected a positive sample time [s]"))?;
        require(substeps > 0, || "substeps is 0, expected at least 1".to_owned())?;
        Ok(Self { dt, substeps, method, hold })
    }

    /// Steps that a simulation of so many samples takes.
    #[must_use]
    pub fn steps(&self, samples: usize) -> usize {
        samples.saturating_mul(self.substeps)
    }
}
