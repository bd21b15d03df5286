//! Outputs and their sensitivities, sample by sample.

use crate::drive_train::Run;
use crate::error::{Result, require};
use crate::stop::{CHECK_EVERY, Stop};

use super::output::Output;
use super::parameters::{MOST, Subject};
use super::pass::march;

/// Simulate `outputs` into `values` `[output, sample]`, and their derivatives in each direction of the subject into
/// `slopes` `[direction, output, sample]`.
///
/// # Errors
/// [`Error::Invalid`](crate::error::Error::Invalid) for a run or lengths that don't fit,
/// [`Error::Diverged`](crate::error::Error::Diverged) where a result is not finite,
/// [`Error::Stopped`](crate::error::Error::Stopped) on request.
pub fn simulate(
    subject: &Subject,
    run: &Run<'_>,
    outputs: &[Output],
    values: &mut [f64],
    slopes: &mut [f64],
    stop: &Stop,
) -> Result<()> {
    run.check()?;
    let length = outputs.len() * run.set_speed.len();
    require(values.len() == length && slopes.len() == subject.directions() * length, || {
        format!(
            "found room for {} values and {} slopes, expected {length} and their slopes",
            values.len(),
            slopes.len()
        )
    })?;
    match subject.directions() {
        0 => fill::<0>(subject, run, outputs, values, slopes, stop),
        1..=8 => fill::<8>(subject, run, outputs, values, slopes, stop),
        9..=16 => fill::<16>(subject, run, outputs, values, slopes, stop),
        _ => fill::<MOST>(subject, run, outputs, values, slopes, stop),
    }
}

fn fill<const N: usize>(
    subject: &Subject,
    run: &Run<'_>,
    outputs: &[Output],
    values: &mut [f64],
    slopes: &mut [f64],
    stop: &Stop,
) -> Result<()> {
    let (count, samples) = (outputs.len(), run.set_speed.len());
    march::<N>(subject, run, outputs, CHECK_EVERY, stop, &mut |from, rows| {
        for (k, row) in rows.chunks_exact(count).enumerate() {
            for (output, number) in row.iter().enumerate() {
                values[output * samples + from + k] = number.value;
                for (direction, slope) in number.slopes[..subject.directions()].iter().enumerate() {
                    slopes[(direction * count + output) * samples + from + k] = *slope;
                }
            }
        }
        Ok(())
    })
}
