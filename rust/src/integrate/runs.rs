//! What to simulate.

use crate::error::{Error, Result, require};
use crate::plant::{PARAMETERS, Plant};

/// Plants, each from its own state, under its own set point or a common one.
#[derive(Debug, Clone)]
pub struct Runs<'a> {
    pub(super) plants: Vec<Plant>,
    /// Shaft speed [rev/s] and integrated error [rev] at the first sample.
    pub(super) initial: Vec<[f64; 2]>,
    pub(super) samples: usize,
    set_speeds: &'a [f64],
    /// Whether runs are numbered in messages.
    pub(super) numbered: bool,
}

/// A matrix, row by row.
#[derive(Debug, Clone, Copy)]
pub struct Rows<'a> {
    /// As many as the shape says.
    pub values: &'a [f64],
    /// Rows and columns.
    pub shape: [usize; 2],
}

impl<'a> Rows<'a> {
    fn iter(&self) -> impl Iterator<Item = &'a [f64]> + use<'a> {
        // An empty row can't be a chunk; the checks of `Runs` refuse it with a message.
        self.values.chunks_exact(self.shape[1].max(1))
    }
}

impl<'a> Runs<'a> {
    /// One plant, its parameters in the order of [`PARAMETERS`], under a set point of the engine speed [rev/s].
    ///
    /// # Errors
    /// Where a length is wrong or a value makes no sense; the message names it.
    pub fn one(parameters: &[f64], set_speed: &'a [f64], initial: &[f64]) -> Result<Self> {
        check_set_speed(set_speed, "n_set")?;
        Ok(Self {
            plants: vec![Plant::from_parameters(parameters, "parameters")?],
            initial: vec![check_initial(initial, "initial")?],
            samples: set_speed.len(),
            set_speeds: set_speed,
            numbered: false,
        })
    }

    /// Several plants: a row each of parameters and of the initial state, a row each or one for all of the set point.
    ///
    /// # Errors
    /// Where a shape is wrong or a value makes no sense; the message names it.
    pub fn many(parameters: Rows<'_>, set_speeds: Rows<'a>, initial: Rows<'_>) -> Result<Self> {
        let [members, width] = parameters.shape;
        let [rows, samples] = set_speeds.shape;
        let shaped = |ok: bool, name: &str, found: [usize; 2], expected: String| {
            require(ok, || format!("{name} has shape {found:?}, expected {expected}"))
        };
        let columns = PARAMETERS.len();
        shaped(width == columns, "parameters", parameters.shape, format!("[members, {columns}]"))?;
        shaped(
            rows == 1 || rows == members,
            "n_set",
            set_speeds.shape,
            format!("[1, samples] or [{members}, samples]"),
        )?;
        shaped(initial.shape == [members, 2], "initial", initial.shape, format!("[{members}, 2]"))?;
        require(samples > 0, || "n_set has no samples, expected at least 1".to_owned())?;
        for (row, values) in set_speeds.iter().enumerate() {
            check_set_speed(values, &format!("n_set[{row}]"))?;
        }
        let plants = parameters.iter().enumerate();
        let states = initial.iter().enumerate();
        Ok(Self {
            plants: plants
                .map(|(member, values)| Plant::from_parameters(values, &format!("parameters[{member}]")))
                .collect::<Result<_>>()?,
            initial: states
                .map(|(member, values)| check_initial(values, &format!("initial[{member}]")))
                .collect::<Result<_>>()?,
            samples,
            set_speeds: set_speeds.values,
            numbered: true,
        })
    }

    /// Number of runs.
    #[must_use]
    pub fn len(&self) -> usize {
        self.plants.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.plants.is_empty()
    }

    /// The set point of all runs, where they have it in common.
    pub(super) fn common_set_speed(&self) -> Option<&'a [f64]> {
        (self.set_speeds.len() == self.samples).then_some(self.set_speeds)
    }

    /// The set point of a run that has its own.
    pub(super) fn set_speed(&self, run: usize) -> &'a [f64] {
        &self.set_speeds[run * self.samples..(run + 1) * self.samples]
    }
}

fn check_set_speed(set_speed: &[f64], label: &str) -> Result<()> {
    require(!set_speed.is_empty(), || format!("{label} has no samples, expected at least 1"))?;
    match set_speed.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(bad) => Err(Error::Invalid(format!(
            "{label} is {} at sample {bad}, expected finite speeds [rev/s]; bridge gaps first",
            set_speed[bad]
        ))),
    }
}

fn check_initial(initial: &[f64], label: &str) -> Result<[f64; 2]> {
    match *initial {
        [speed, error] if speed.is_finite() && error.is_finite() => Ok([speed, error]),
        _ => Err(Error::Invalid(format!(
            "{label} is {initial:?}, expected two finite numbers: shaft speed [rev/s], integrated error [rev]"
        ))),
    }
}
