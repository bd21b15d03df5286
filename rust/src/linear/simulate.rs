//! Simulated outputs and their sensitivities, sample by sample.

use super::basis::Basis;
use super::parameters::{By, OUTPUTS, Output, Parameters};
use super::segmented_pass::{BLOCK, Drive, LANES, Layout, walk};
use crate::error::{Error, Result};
use crate::stop::Stop;

/// Simulate `outputs` into `values` `[output, sample]`, and their derivatives by `wrt` into `derivatives`
/// `[wrt, output, sample]`.
///
/// # Errors
/// [`Error::Diverged`] where a row leaves the finite numbers,
/// [`Error::Stopped`] on request.
///
/// # Panics
/// Where `values` or `derivatives` has not the length said above.
pub fn simulate(
    parameters: &Parameters,
    drive: &Drive<'_>,
    outputs: &[Output],
    wrt: &[By],
    values: &mut [f64],
    derivatives: &mut [f64],
    stop: &Stop,
) -> Result<()> {
    let samples = drive.samples();
    assert_eq!(values.len(), outputs.len() * samples, "length of the values");
    assert_eq!(derivatives.len(), wrt.len() * outputs.len() * samples, "length of the derivatives");
    let basis = Basis::new(outputs, wrt);
    let value_rows: Vec<_> = outputs.iter().map(|&output| basis.output(output, parameters)).collect();
    let derivative_rows: Vec<_> = wrt
        .iter()
        .flat_map(|&by| outputs.iter().map(move |&output| (by, output)))
        .map(|(by, output)| basis.sensitivity(output, by, parameters))
        .collect();
    let mut fill = |layout| -> Result<bool> {
        let mut are_finite = true;
        walk(parameters, drive, &basis, layout, stop, |mut block| {
            let mut finished = [0.0; BLOCK];
            let values = values.chunks_exact_mut(samples).zip(&value_rows);
            for (series, combination) in
                values.chain(derivatives.chunks_exact_mut(samples).zip(&derivative_rows))
            {
                combine(block.rows(), combination, &mut finished);
                are_finite &= all_numbers(&finished);
                block.take(&finished, series);
            }
            Ok(())
        })?;
        Ok(are_finite)
    };
    // Where segments meet, infinity times zero can turn up before the simulation itself leaves the numbers: look again.
    if fill(Layout::Segments)? || fill(Layout::Sequential)? {
        return Ok(());
    }
    let diverged = first_not_finite(values, derivatives, samples, outputs);
    diverged.map_or(Ok(()), |(sample, what)| {
        Err(Error::Diverged { sample, time: sample as f64 * drive.dt(), what })
    })
}

/// Whether a block is finite. It is looked at while it is in the fastest cache: a result is not read again.
fn all_numbers(block: &[f64; BLOCK]) -> bool {
    let mut sums = [0.0; LANES];
    for pack in block.as_chunks::<LANES>().0 {
        for (sum, value) in sums.iter_mut().zip(pack) {
            *sum += value * 0.0; // NaN from what is not finite
        }
    }
    sums.iter().all(|sum| *sum == 0.0)
}

/// The combination of a block's rows with those factors.
fn combine(rows: &[f64], combination: &[f64], sum: &mut [f64; BLOCK]) {
    sum.fill(0.0);
    for (row, &factor) in rows.chunks_exact(BLOCK).zip(combination) {
        if factor != 0.0 {
            for (sum, &value) in sum.iter_mut().zip(row) {
                *sum += factor * value;
            }
        }
    }
}

fn first_not_finite(
    values: &[f64],
    derivatives: &[f64],
    samples: usize,
    outputs: &[Output],
) -> Option<(usize, &'static str)> {
    let first = |row: &[f64]| row.iter().position(|value| !value.is_finite());
    let names = outputs.iter().map(|&output| OUTPUTS[output as usize]);
    let in_values =
        values.chunks_exact(samples).zip(names).filter_map(|(row, name)| Some((first(row)?, name)));
    let in_derivatives =
        derivatives.chunks_exact(samples).filter_map(|row| Some((first(row)?, "a sensitivity")));
    in_values.chain(in_derivatives).min()
}
