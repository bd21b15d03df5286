//! What to simulate.

use crate::error::{Error, Result, require};
use crate::plant::Plant;

/// A plant, from a state of its own, under a set point.
#[derive(Debug, Clone, Copy)]
pub struct Run<'a> {
    pub(super) plant: Plant,
    /// Shaft speed [rev/s] and integrated error [rev] at the first sample.
    pub(super) initial: [f64; 2],
    /// Of the engine speed [rev/s].
    pub(super) set_speed: &'a [f64],
}

impl<'a> Run<'a> {
    /// Check and collect: the plant's parameters in the order of [`PARAMETERS`](crate::plant::PARAMETERS), the set point, and
    /// shaft speed and integrated error at the first sample.
    ///
    /// # Errors
    /// Where a length is wrong or a value makes no sense; the message names it.
    pub fn new(parameters: &[f64], set_speed: &'a [f64], initial: &[f64]) -> Result<Self> {
        require(!set_speed.is_empty(), || "n_set has no samples, expected at least 1".to_owned())?;
        if let Some(bad) = set_speed.iter().position(|value| !value.is_finite()) {
            let found = set_speed[bad];
            return Err(Error::Invalid(format!(
                "n_set is {found} at sample {bad}, expected finite speeds [rev/s]; bridge gaps first"
            )));
        }
        let plant = Plant::from_parameters(parameters, "parameters")?;
        match *initial {
            [speed, error] if speed.is_finite() && error.is_finite() => {
                Ok(Self { plant, initial: [speed, error], set_speed })
            }
            _ => Err(Error::Invalid(format!(
                "initial is {initial:?}, expected two finite numbers: shaft speed [rev/s], integrated error [rev]"
            ))),
        }
    }
}
