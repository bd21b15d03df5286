//! Euler, Heun and RK4 for a ship whose only states are speed and integral: the thesis's plant (eq. 3.1-3.11) with any step
//! length.

use std::str::FromStr;

use crate::error::{Error, Result, require};
use crate::hold::Hold;
use crate::stop::Stop;
use crate::subnormal::cut;

use super::output::{OUTPUTS, Output};
use super::parameters::{PARAMETERS, Parameters, at};
use super::run::Run;
use super::step::Ship;

/// Parameters of such a ship.
const KNOWN: [usize; 15] = [
    at::TAU_N,
    at::G,
    at::V,
    at::K_P,
    at::K_I,
    at::P,
    at::TAU_PROP,
    at::M_MAX,
    at::M_MAX_SLOPE,
    at::M_SOFT,
    at::M_MIN,
    at::X_MAX,
    at::X_MIN,
    at::DAMPING,
    at::CURVATURE,
];
/// Steps between two checks for a stop.
const STEPS_BETWEEN_CHECKS: usize = 1 << 14;

/// An explicit one-step method.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Forward Euler, as in the thesis's virtual data.
    Euler,
    /// Explicit trapezoid.
    Heun,
    /// Classical fourth-order Runge-Kutta.
    Rk4,
}

impl FromStr for Method {
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

/// Speed relative to the operating point and integral [s], or their rates.
type State = [f64; 2];

/// Simulate from a speed and an integral at the first sample into rows of the outputs, `[output, sample]`.
///
/// # Errors
/// [`Error::Invalid`] for an element that such a ship does not have or a start that is not finite, [`Error::Diverged`] if
/// the speed diverges, [`Error::Stopped`] on request.
pub fn simulate_explicitly(
    parameters: &Parameters,
    run: &Run<'_>,
    method: Method,
    initial: &[f64],
    outputs: &[Output],
    rows: &mut [f64],
    stop: &Stop,
) -> Result<()> {
    let mut state: State = match *initial {
        [speed, sum] if speed.is_finite() && sum.is_finite() => [speed, sum],
        _ => {
            return Err(Error::Invalid(format!(
                "initial is {initial:?}, expected two finite numbers: speed over the operating point's, the governor's sum"
            )));
        }
    };
    run.check(parameters)?;
    let odd = (0..PARAMETERS.len()).find(|place| !KNOWN.contains(place) && !parameters.is_off(*place));
    require(odd.is_none() && run.load.is_empty(), || {
        let name = odd.map_or("load", |place| PARAMETERS[place]);
        format!("found {name}, expected a ship without it: these methods know speed and sum alone")
    })?;
    let samples = run.set.len();
    require(rows.len() == samples * outputs.len(), || format!("found room for {} values", rows.len()))?;
    let mut ship: Ship<'_, false> = Ship::new(parameters, run);
    let (step, mut unchecked) = (run.step(), 0);
    for (sample, &now) in run.set.iter().enumerate() {
        state[1] = cut(state[1]);
        for (row, &output) in rows.chunks_exact_mut(samples).zip(outputs) {
            row[sample] = shown(&mut ship, now, state, output);
            if !row[sample].is_finite() {
                let what = OUTPUTS[output as usize];
                return Err(Error::Diverged { sample, time: sample as f64 * run.dt, what });
            }
        }
        let Some(&next) = run.set.get(sample + 1) else {
            break;
        };
        let slope = if run.hold == Hold::First { (next - now) / run.substeps as f64 } else { 0.0 };
        for passed in 0..run.substeps {
            let from = now + slope * passed as f64;
            state = advanced(&mut ship, method, [from, from + 0.5 * slope, from + slope], state, step);
            unchecked += 1;
            if unchecked == STEPS_BETWEEN_CHECKS {
                unchecked = 0;
                stop.check()?;
            }
        }
    }
    Ok(())
}

/// State after a step `h`, with the set point at its beginning, middle and end.
#[inline(always)]
fn advanced(ship: &mut Ship<'_, false>, method: Method, set: [f64; 3], state: State, h: f64) -> State {
    let first = rate(ship, set[0], state);
    match method {
        Method::Euler => after(state, first, h),
        Method::Heun => {
            let second = rate(ship, set[2], after(state, first, h));
            after(after(state, first, 0.5 * h), second, 0.5 * h)
        }
        Method::Rk4 => {
            let second = rate(ship, set[1], after(state, first, 0.5 * h));
            let third = rate(ship, set[1], after(state, second, 0.5 * h));
            let fourth = rate(ship, set[2], after(state, third, h));
            let sum = after(after(after(first, second, 2.0), third, 2.0), fourth, 1.0);
            after(state, sum, h / 6.0)
        }
    }
}

#[inline(always)]
fn after(state: State, rate: State, time: f64) -> State {
    [state[0] + rate[0] * time, state[1] + rate[1] * time]
}

#[inline(always)]
fn rate(ship: &mut Ship<'_, false>, set: f64, [speed, sum]: State) -> State {
    let rack = ship.within_limits(ship.commanded(set - speed, sum, 0.0));
    let torque = ship.engine(speed, rack).0 - ship.law_of.value(speed);
    [torque * ship.c.inverse_tau, set - speed]
}

fn shown(ship: &mut Ship<'_, false>, set: f64, [speed, sum]: State, output: Output) -> f64 {
    let rack = ship.within_limits(ship.commanded(set - speed, sum, 0.0));
    match output {
        Output::Speed | Output::PropellerSpeed => speed - 1.0,
        Output::Sum => sum,
        Output::Rack => rack,
        Output::EngineTorque => ship.engine(speed, rack).0 - 1.0,
        Output::GaugeTorque => {
            let acceleration = rate(ship, set, [speed, sum])[0];
            ship.law_of.value(speed) + ship.c.tau_prop * acceleration - 1.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::parameters::OFF;
    use super::*;

    /// Under a constant load, `tau_n` n' = g (n - 1): a step of order q is the exponential's series up to the power q.
    #[test]
    fn methods_reproduce_the_exponential_to_their_order() {
        let mut values = OFF;
        for (place, value) in [at::TAU_N, at::G, at::V, at::K_P, at::K_I, at::P]
            .into_iter()
            .zip([1.0, -0.7, 1.0, 0.0, 0.0, 0.0])
        {
            values[place] = value;
        }
        let parameters = Parameters::new(&values, "parameters").unwrap();
        let run = Run::new(&[1.0, 1.0], &[], 0.3, 1, Hold::Zero).unwrap();
        let found = |method| {
            let mut rows = [0.0; 2];
            simulate_explicitly(
                &parameters,
                &run,
                method,
                &[1.5, 0.0],
                &[Output::Speed],
                &mut rows,
                &Stop::new(),
            )
            .unwrap();
            rows[1] / rows[0]
        };
        let z: f64 = -0.7 * 0.3;
        let heun = 1.0 + z + z.powi(2) / 2.0;
        assert!((found(Method::Euler) - (1.0 + z)).abs() < 1e-14);
        assert!((found(Method::Heun) - heun).abs() < 1e-14);
        assert!((found(Method::Rk4) - (heun + z.powi(3) / 6.0 + z.powi(4) / 24.0)).abs() < 1e-14);
    }
}
