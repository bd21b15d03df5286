//! Linear state space of any order: exact simulation between samples and frequency response, for structures of a user's own.
//!
//! ```text
//! x' = A x + B u      y = C x + D u
//! ```
//!
//! with one input and as many outputs as `C` has rows.

use std::f64::consts::TAU;

use nalgebra::{Complex, DMatrix, DVector};

use crate::error::{Error, Result, require};
use crate::hold::Hold;
use crate::stop::Stop;
use crate::subnormal::cut_all;

/// Samples between two looks at the stop flag and the results, and two cuts of what has decayed.
const BLOCK: usize = 256;

/// A checked continuous-time model.
#[derive(Debug, Clone, PartialEq)]
pub struct StateSpace {
    a: DMatrix<f64>,
    b: DVector<f64>,
    c: DMatrix<f64>,
    d: DVector<f64>,
}

impl StateSpace {
    /// Check and collect: `a` `[n, n]`, `b` `[n]`, `c` `[outputs, n]` and `d` `[outputs]`, row after row.
    ///
    /// # Errors
    /// [`Error::Invalid`] where the lengths don't fit together, there is no state or output, or a value is not finite.
    pub fn new(a: &[f64], b: &[f64], c: &[f64], d: &[f64]) -> Result<Self> {
        let (states, outputs) = (b.len(), d.len());
        require(states > 0 && outputs > 0, || {
            format!("B has {states} values and D {outputs}, expected at least one state and one output")
        })?;
        for (name, values, expected) in [("A", a, states * states), ("C", c, outputs * states)] {
            require(values.len() == expected, || {
                format!(
                    "{name} has {} values, expected {expected} with {states} in B and {outputs} in D",
                    values.len()
                )
            })?;
        }
        for (name, values) in [("A", a), ("B", b), ("C", c), ("D", d)] {
            if let Some(bad) = values.iter().find(|value| !value.is_finite()) {
                return Err(Error::Invalid(format!("{name} holds {bad}, expected finite numbers")));
            }
        }
        Ok(Self {
            a: DMatrix::from_row_slice(states, states, a),
            b: DVector::from_column_slice(b),
            c: DMatrix::from_row_slice(outputs, states, c),
            d: DVector::from_column_slice(d),
        })
    }

    /// Number of states.
    #[must_use]
    pub fn states(&self) -> usize {
        self.b.len()
    }

    /// Number of outputs.
    #[must_use]
    pub fn outputs(&self) -> usize {
        self.d.len()
    }

    /// Simulate from the state `initial` at the first sample; `output` `[outputs, samples]` is filled row after row.
    ///
    /// # Errors
    /// [`Error::Invalid`] for values that can't be used, [`Error::Diverged`] where an output is not finite,
    /// [`Error::Stopped`] on request.
    pub fn simulate(
        &self,
        input: &[f64],
        dt: f64,
        hold: Hold,
        initial: &[f64],
        output: &mut [f64],
        stop: &Stop,
    ) -> Result<()> {
        require(!input.is_empty(), || "u has no samples, expected at least 1".to_owned())?;
        if let Some(bad) = input.iter().position(|value| !value.is_finite()) {
            return Err(Error::Invalid(format!(
                "u[{bad}] is {}, expected a finite number; bridge gaps before",
                input[bad]
            )));
        }
        require(dt.is_finite() && dt > 0.0, || format!("dt is {dt}, expected a positive sample time [s]"))?;
        require(initial.len() == self.states() && initial.iter().all(|value| value.is_finite()), || {
            format!("initial is {initial:?}, expected {} finite numbers, one a state", self.states())
        })?;
        require(output.len() == self.outputs() * input.len(), || {
            format!("output has {} values, expected {} rows of {}", output.len(), self.outputs(), input.len())
        })?;
        let step = self.discretise(dt, hold);
        match self.states() {
            1 => walk(&step, input, dt, [0.0; 1], initial, output, stop),
            2 => walk(&step, input, dt, [0.0; 2], initial, output, stop),
            3 => walk(&step, input, dt, [0.0; 3], initial, output, stop),
            4 => walk(&step, input, dt, [0.0; 4], initial, output, stop),
            6 => walk(&step, input, dt, [0.0; 6], initial, output, stop),
            8 => walk(&step, input, dt, [0.0; 8], initial, output, stop),
            order => walk(&step, input, dt, vec![0.0; order], initial, output, stop),
        }
    }

    /// One sample exactly: with the input a polynomial between samples, its derivatives are states too (Van Loan 1978,
    /// DOI 10.1109/TAC.1978.1101743).
    fn discretise(&self, dt: f64, hold: Hold) -> Step {
        let n = self.states();
        let mut augmented = DMatrix::zeros(n + 2, n + 2);
        augmented.view_mut((0, 0), (n, n)).copy_from(&(&self.a * dt));
        augmented.view_mut((0, n), (n, 1)).copy_from(&(&self.b * dt));
        augmented[(n, n + 1)] = 1.0;
        let step = exponential(&augmented);
        let held = step.view((0, n), (n, 1)).into_owned();
        let ramp = step.view((0, n + 1), (n, 1)).into_owned();
        let (now, next) = match hold {
            Hold::Zero => (held.clone(), DMatrix::zeros(n, 1)),
            Hold::First => (&held - &ramp, ramp),
        };
        let row_major = |matrix: &DMatrix<f64>| matrix.transpose().as_slice().to_vec();
        Step {
            phi: row_major(&step.view((0, 0), (n, n)).into_owned()),
            now: now.as_slice().to_vec(),
            next: next.as_slice().to_vec(),
            c: row_major(&self.c),
            d: self.d.as_slice().to_vec(),
        }
    }

    /// Frequency responses from the input to every output, `[outputs, frequency]`, row after row.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a frequency that is negative or not finite, or at which the response is infinite.
    pub fn response(&self, frequency_hz: &[f64], stop: &Stop) -> Result<Vec<Complex<f64>>> {
        let (a, b, c) = (self.a.map(Complex::from), self.b.map(Complex::from), self.c.map(Complex::from));
        let mut values = vec![Complex::ZERO; self.outputs() * frequency_hz.len()];
        for (column, &frequency) in frequency_hz.iter().enumerate() {
            stop.check()?;
            require(frequency.is_finite() && frequency >= 0.0, || {
                format!(
                    "frequency_hz[{column}]: found {frequency}, expected a finite frequency of 0 Hz or more"
                )
            })?;
            let mut resolvent = -&a;
            for state in 0..self.states() {
                resolvent[(state, state)] += Complex::new(0.0, TAU * frequency);
            }
            let response = resolvent.lu().solve(&b).map(|state| &c * state + self.d.map(Complex::from));
            let Some(response) = response.filter(|rows| rows.iter().all(|value| value.is_finite())) else {
                return Err(Error::Invalid(format!(
                    "frequency_hz[{column}]: the response is infinite at {frequency} Hz, a pole of A; leave it out"
                )));
            };
            for (row, &value) in response.iter().enumerate() {
                values[row * frequency_hz.len() + column] = value;
            }
        }
        Ok(values)
    }
}

/// `x[k+1] = phi x[k] + now u[k] + next u[k+1]`, `y[k] = c x[k] + d u[k]`; matrices row after row.
struct Step {
    phi: Vec<f64>,
    now: Vec<f64>,
    next: Vec<f64>,
    c: Vec<f64>,
    d: Vec<f64>,
}

/// Step through the samples. For a state of known length the inner loops unroll; twice a small order is that of derivatives.
fn walk<S: AsRef<[f64]> + AsMut<[f64]> + Clone>(
    step: &Step,
    input: &[f64],
    dt: f64,
    mut state: S,
    initial: &[f64],
    output: &mut [f64],
    stop: &Stop,
) -> Result<()> {
    let order = state.as_ref().len();
    let mut next = state.clone();
    let samples = input.len();
    state.as_mut().copy_from_slice(initial);
    for from in (0..samples).step_by(BLOCK) {
        let to = (from + BLOCK).min(samples);
        for k in from..to {
            let u = input[k];
            for ((row, c), d) in step.c.chunks_exact(order).enumerate().zip(&step.d) {
                output[row * samples + k] = dot(c, state.as_ref()) + d * u;
            }
            let after = input[(k + 1).min(samples - 1)];
            let rows = step.phi.chunks_exact(order).zip(step.now.iter().zip(&step.next));
            for (value, (phi, (now, late))) in next.as_mut().iter_mut().zip(rows) {
                *value = dot(phi, state.as_ref()) + now * u + late * after;
            }
            state.as_mut().copy_from_slice(next.as_ref());
        }
        cut_all(state.as_mut());
        for row in output.chunks_exact(samples) {
            if let Some(bad) = row[from..to].iter().position(|value| !value.is_finite()) {
                let sample = from + bad;
                return Err(Error::Diverged { sample, time: sample as f64 * dt, what: "an output" });
            }
        }
        stop.check()?;
    }
    Ok(())
}

#[inline(always)]
fn dot(row: &[f64], state: &[f64]) -> f64 {
    row.iter().zip(state).map(|(a, x)| a * x).sum()
}

/// Matrix exponential by a Taylor polynomial, scaling and squaring, as that of the linear structure but of any size.
fn exponential(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    /// With a norm of at most 1/2 the first term left out is below 2e-17.
    const DEGREE: u32 = 14;
    let norm = matrix.column_iter().map(|column| column.lp_norm(1)).fold(0.0, f64::max);
    #[allow(clippy::cast_possible_truncation)] // clamped first
    let squarings = (2.0 * norm).log2().ceil().clamp(0.0, 100.0) as i32;
    let scaled = matrix * 0.5_f64.powi(squarings);
    let identity = DMatrix::identity(matrix.nrows(), matrix.ncols());
    let series = (2..=DEGREE)
        .rev()
        .fold(identity.clone(), |series, term| &identity + &scaled * series / f64::from(term));
    // exp - 1 is squared, not exp: slow modes beside fast ones would drown in the 1.
    let less_one =
        (0..squarings).fold(&scaled * series, |less_one, _| &less_one * &less_one + &less_one * 2.0);
    less_one + identity
}
