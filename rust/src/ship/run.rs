//! What a simulation of the ship runs over.

use crate::error::{Error, Result, require};
use crate::finite::all_finite;
use crate::integrate::Hold;

/// Most steps a sample that can be asked for.
const MOST_SUBSTEPS: usize = 1 << 16;

/// A record's inputs and the steps through them.
#[derive(Debug, Clone, Copy)]
pub struct Run<'a> {
    /// Set point over the operating point's speed.
    pub set: &'a [f64],
    /// Deviation of the measured load torque; empty without one.
    pub load: &'a [f64],
    /// Sample time [s].
    pub dt: f64,
    /// Steps a sample, 0 for as many as the accuracy asks for.
    pub substeps: usize,
    /// Of both inputs between samples.
    pub hold: Hold,
    /// Whether breaks of the inputs are followed until none is left that a millionth of a step would show. Otherwise, in half
    /// the time, only through the first dead time: signals are then off by up to a thousandth of a step where it arrives again.
    pub sharp: bool,
}

impl<'a> Run<'a> {
    /// Check and collect.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a set point without samples, a load of another length, a value that is not finite, a sample time
    /// that is not positive, or too many substeps.
    pub fn new(set: &'a [f64], load: &'a [f64], dt: f64, substeps: usize, hold: Hold) -> Result<Self> {
        require(!set.is_empty(), || "u has no samples, expected at least 1".to_owned())?;
        require(load.is_empty() || load.len() == set.len(), || {
            format!("load has {} samples, expected none or {}, those of u", load.len(), set.len())
        })?;
        require(dt.is_finite() && dt > 0.0, || format!("dt is {dt}, expected a positive sample time [s]"))?;
        require(substeps <= MOST_SUBSTEPS, || {
            format!("substeps is {substeps}, expected 0 to {MOST_SUBSTEPS}, 0 for as many as needed")
        })?;
        for (name, values) in [("u", set), ("load", load)] {
            if !all_finite(values) {
                let bad = values.iter().position(|value| !value.is_finite()).unwrap_or_default();
                return Err(Error::Invalid(format!(
                    "{name}[{bad}] is {}, expected a finite number; bridge gaps before",
                    values[bad]
                )));
            }
        }
        Ok(Self { set, load, dt, substeps, hold, sharp: true })
    }

    /// Number of samples.
    #[must_use]
    pub const fn samples(&self) -> usize {
        self.set.len()
    }
}
