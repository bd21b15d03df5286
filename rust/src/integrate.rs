//! Fixed-step integration of the plant: single runs and batches.

mod method;
mod scheme;

use rayon::prelude::*;

use crate::error::{Error, Result, require};
use crate::plant::{Envelope, Limit, PARAMETERS, Plant, State};
use crate::pool::on_threads;
use crate::stop::{CHECK_EVERY, Stop};
use method::{Euler, Heun, Method, Rk4};
pub use scheme::{Hold, MethodName, Scheme};

/// Rows of an output: `n_s` [rev/s], `E_n` [rev], `X_f` [mm], `M_b` [Nm].
pub const ROWS: usize = 4;
const ROW_NAMES: [&str; ROWS] = ["n_s", "E_n", "X_f", "M_b"];

/// Samples between two looks at the stop flag and the results: small enough that the results are still in the cache.
const BLOCK: usize = 1024;

/// Simulate one plant; row k of `output` is the state at sample k with `set_speed[k]` already applied.
///
/// `set_speed` is the set point of the engine speed [rev/s], `initial` the first shaft speed [rev/s] and integrated
/// error [rev], `output` has [`ROWS`] rows of as many samples as `set_speed`.
///
/// # Errors
/// [`Error::Invalid`] for shapes and values, [`Error::Diverged`] where a result is not finite, [`Error::Stopped`].
pub fn simulate(
    plant: &Plant,
    envelope: &Envelope,
    set_speed: &[f64],
    scheme: &Scheme,
    initial: &[f64],
    output: &mut [f64],
    stop: &Stop,
) -> Result<()> {
    check_set_speed(set_speed, "n_set")?;
    require(output.len() == ROWS * set_speed.len(), || {
        format!("output has {} values, expected {ROWS} rows of {}", output.len(), set_speed.len())
    })?;
    let state = initial_state(initial, "initial")?;
    run(plant, envelope, set_speed, scheme, state, output, stop)
}

/// Simulate a batch of plants; `parameters` has a row of [`PARAMETERS`] a member, `set_speed` one row for all or one each,
/// `initial` a row of two a member, `output` [`ROWS`] rows a member.
///
/// # Errors
/// As [`simulate`]; of several members that diverge, the first is reported.
#[allow(clippy::too_many_arguments)]
pub fn simulate_batch(
    parameters: &[f64],
    envelope: &Envelope,
    set_speed: &[f64],
    samples: usize,
    scheme: &Scheme,
    initial: &[f64],
    threads: usize,
    output: &mut [f64],
    stop: &Stop,
) -> Result<()> {
    let members = parameters.len() / PARAMETERS.len();
    require(samples > 0, || "n_set has no samples, expected at least 1".to_owned())?;
    let shared = set_speed.len() == samples;
    for (row, values) in set_speed.chunks_exact(samples).enumerate() {
        check_set_speed(values, &format!("n_set[{row}]"))?;
    }
    let plants = parameters
        .chunks_exact(PARAMETERS.len())
        .enumerate()
        .map(|(member, values)| Plant::from_parameters(values, &format!("parameters[{member}]")))
        .collect::<Result<Vec<_>>>()?;
    let states = initial
        .chunks_exact(2)
        .enumerate()
        .map(|(member, values)| initial_state(values, &format!("initial[{member}]")))
        .collect::<Result<Vec<_>>>()?;
    require(states.len() == members && output.len() == members * ROWS * samples, || {
        format!(
            "initial has {} rows, output {} values; expected {members} members",
            states.len(),
            output.len()
        )
    })?;
    let outcomes: Vec<Result<()>> = on_threads(threads, || {
        Ok(output
            .par_chunks_exact_mut(ROWS * samples)
            .enumerate()
            .map(|(member, output)| {
                let from = if shared { 0 } else { member * samples };
                run(
                    &plants[member],
                    envelope,
                    &set_speed[from..from + samples],
                    scheme,
                    states[member],
                    output,
                    stop,
                )
            })
            .collect())
    })?;
    outcomes.into_iter().collect()
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

fn initial_state(initial: &[f64], label: &str) -> Result<State> {
    match *initial {
        [speed, error] if speed.is_finite() && error.is_finite() => Ok(State { speed, error }),
        _ => Err(Error::Invalid(format!(
            "{label} is {initial:?}, expected two finite numbers: shaft speed [rev/s], integrated error [rev]"
        ))),
    }
}

/// Choose the loop compiled for this method, hold, exponent and envelope.
fn run(
    plant: &Plant,
    envelope: &Envelope,
    set_speed: &[f64],
    scheme: &Scheme,
    state: State,
    output: &mut [f64],
    stop: &Stop,
) -> Result<()> {
    match scheme.method {
        MethodName::Euler => run_method::<Euler>(plant, envelope, set_speed, scheme, state, output, stop),
        MethodName::Heun => run_method::<Heun>(plant, envelope, set_speed, scheme, state, output, stop),
        MethodName::Rk4 => run_method::<Rk4>(plant, envelope, set_speed, scheme, state, output, stop),
    }
}

fn run_method<M: Method>(
    plant: &Plant,
    envelope: &Envelope,
    set_speed: &[f64],
    scheme: &Scheme,
    state: State,
    output: &mut [f64],
    stop: &Stop,
) -> Result<()> {
    match (plant.is_square(), envelope) {
        (true, Envelope::Constant(limit)) => {
            run_loop::<M, true>(plant, *limit, set_speed, scheme, state, output, stop)
        }
        (false, Envelope::Constant(limit)) => {
            run_loop::<M, false>(plant, *limit, set_speed, scheme, state, output, stop)
        }
        (true, Envelope::Table(table)) => {
            run_loop::<M, true>(plant, table.cursor(), set_speed, scheme, state, output, stop)
        }
        (false, Envelope::Table(table)) => {
            run_loop::<M, false>(plant, table.cursor(), set_speed, scheme, state, output, stop)
        }
    }
}

fn run_loop<M: Method, const SQUARE: bool>(
    plant: &Plant,
    mut limit: impl Limit,
    set_speed: &[f64],
    scheme: &Scheme,
    mut state: State,
    output: &mut [f64],
    stop: &Stop,
) -> Result<()> {
    let plant = *plant;
    let samples = set_speed.len();
    let step = scheme.dt / scheme.substeps as f64;
    let fraction = match scheme.hold {
        Hold::Zero => 0.0,
        Hold::First => 1.0 / scheme.substeps as f64,
    };
    let (speeds, rest) = output.split_at_mut(samples);
    let (errors, rest) = rest.split_at_mut(samples);
    let (racks, torques) = rest.split_at_mut(samples);
    let block = (CHECK_EVERY / scheme.substeps).clamp(1, BLOCK);
    for from in (0..samples).step_by(block) {
        let to = (from + block).min(samples);
        for k in from..to {
            let set = set_speed[k];
            let slope = (set_speed[(k + 1).min(samples - 1)] - set) * fraction;
            let mut torque = plant.torque(&mut limit, set, state);
            speeds[k] = state.speed;
            errors[k] = state.error;
            racks[k] = plant.rack(set, state);
            torques[k] = torque;
            if k + 1 == samples {
                break;
            }
            for substep in 0..scheme.substeps {
                let set = set + slope * substep as f64;
                if substep > 0 {
                    torque = plant.torque(&mut limit, set, state);
                }
                let rate = plant.rate::<SQUARE>(torque, set, state);
                state = M::advance(state, rate, step, |passed, state| {
                    let set = set + slope * passed;
                    plant.rate::<SQUARE>(plant.torque(&mut limit, set, state), set, state)
                });
            }
        }
        check_finite(
            [&speeds[from..to], &errors[from..to], &racks[from..to], &torques[from..to]],
            from,
            scheme.dt,
        )?;
        stop.check()?;
    }
    Ok(())
}

/// A state that is not finite stays so: looking at whole blocks misses none and costs the hot loop nothing.
fn check_finite(rows: [&[f64]; ROWS], from: usize, dt: f64) -> Result<()> {
    let finite = |row: &[f64]| row.iter().fold(true, |finite, value| finite & value.is_finite());
    if rows.iter().all(|row| finite(row)) {
        return Ok(());
    }
    let first = rows
        .iter()
        .zip(ROW_NAMES)
        .filter_map(|(row, name)| Some((row.iter().position(|v| !v.is_finite())?, name)));
    match first.min_by_key(|&(sample, _)| sample) {
        None => Ok(()),
        Some((sample, what)) => {
            Err(Error::Diverged { sample: from + sample, time: (from + sample) as f64 * dt, what })
        }
    }
}
