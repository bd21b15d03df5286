//! The loop without a dead time in it as a recursion of fewest multiplications, for many parameter vectors side by side.
//!
//! With `r` the set point of a sample (whole samples late already), `d` its step from the sample before and `d1` that to the
//! next one, the states are `error = r - n` and `change`, what `n` gains until the next sample beyond what `d1` feeds it:
//!
//! ```text
//! error'  = error - change + lead d1
//! change' = keep change + pull error + push[0] d + push[1] d1
//! n' (rate) = slope[0] error + slope[1] change + slope[2] d
//! ```
//!
//! It is the exact step `x[k+1] = phi x[k] + taps rho[k]` in other coordinates. A set point that stands leaves an error of zero
//! (or, without an integrator, a change of zero), so that `r` itself is not fed in. `keep` and `pull` are `tr phi - 1` and
//! `det(phi - 1)`: like those of a delta operator they keep their digits however short the sample time is against the loop's
//! (Middleton and Goodwin 1986, DOI 10.1109/TAC.1986.1104162).

use super::discrete::{SHORTEST_NETWORK, Step, direct_step};
use super::parameters::Parameters;
use crate::integrate::Hold;

/// See the module.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Increments {
    /// Whole samples by which the set point is late.
    pub late: usize,
    pub lead: f64,
    pub keep: f64,
    pub pull: f64,
    pub push: [f64; 2],
    pub slope: [f64; 3],
    step: Step<2, 1, 3>,
}

impl Increments {
    /// None with a dead time in the loop, and where `E` changes `n` too little over a sample to be computed back from it:
    /// where the loop swings by about half a period within a sample.
    pub fn new(parameters: &Parameters, dt: f64, hold: Hold) -> Option<Self> {
        if parameters.t_d >= SHORTEST_NETWORK * dt {
            return None;
        }
        let (step, late) = direct_step(parameters, dt, hold);
        let [[nn, ne], [en, ee]] = step.phi;
        if en.abs() < 0.01 * dt {
            return None;
        }
        let [[[n0, n1, n2]], [[e0, _, e2]]] = step.taps;
        // c / phi[n][e], also where both are zero: phi is f0 + f1 times the matrix of the loop.
        let per_change = -1.0 / en;
        Some(Self {
            late,
            lead: 1.0 - n2,
            keep: (nn - 1.0) + ee,
            pull: (nn - 1.0) * (ee - 1.0) - ne * en,
            push: [ee * n0 - ne * e0, nn * n2 + ne * e2 + n1],
            slope: [
                per_change * (nn - 1.0) - step.slope[0],
                per_change,
                per_change * n0 - step.slope_feed[0][0],
            ],
            step,
        })
    }

    /// Whether the set point is late at all; if not, `push[0]` and `slope[2]` are zero.
    pub fn is_late(&self) -> bool {
        self.late > 0 || self.push[0] != 0.0 || self.slope[2] != 0.0
    }

    /// Error and change at the first sample, from the initial `n` and `E` and a set point that stood at `set` before.
    pub fn start(&self, [n, e]: [f64; 2], set: f64) -> [f64; 2] {
        let Step { phi: [[nn, ne], _], taps: [[fed], _], .. } = self.step;
        [set - n, (nn - 1.0) * n + ne * e + fed.iter().sum::<f64>() * set]
    }
}
