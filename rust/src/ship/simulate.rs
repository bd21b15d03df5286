//! Outputs of the ship and their sensitivities, sample by sample.

use crate::error::{Result, require};
use crate::stop::Stop;

use super::march::{Task, march};
use super::run::Run;

/// Simulate into `values` `[output, sample]`, and the derivatives into `slopes` `[wrt, output, sample]`.
///
/// # Errors
/// [`Error::Invalid`](crate::error::Error::Invalid) for lengths or parameters that don't fit,
/// [`Error::Diverged`](crate::error::Error::Diverged) where a result is not finite,
/// [`Error::Stopped`](crate::error::Error::Stopped) on request.
pub fn simulate(
    task: &Task<'_>,
    run: &Run<'_>,
    values: &mut [f64],
    slopes: &mut [f64],
    stop: &Stop,
) -> Result<()> {
    let (outputs, samples, directions) = (task.outputs.len(), run.samples(), task.wrt.len());
    let length = outputs * samples;
    require(values.len() == length && slopes.len() == directions * length, || {
        format!(
            "found room for {} values and {} slopes, expected {length} and {directions} times as many",
            values.len(),
            slopes.len()
        )
    })?;
    march(task, run, stop, &mut |block| {
        for output in 0..outputs {
            let place = |row: usize| row * samples + block.from..row * samples + block.from + block.samples;
            values[place(output)].copy_from_slice(block.values(output));
            for direction in 0..directions {
                slopes[place(direction * outputs + output)].copy_from_slice(block.row(output, direction));
            }
        }
        Ok(())
    })
}
