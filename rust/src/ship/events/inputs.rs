//! What acts on the drive train over a stretch in which nothing breaks.

use crate::scalar::Scalar;

use super::command::Past;
use super::flow::{Equations, Input, State};
use super::held::Piece;
use super::terms::Mode;

/// Inputs over a stretch.
#[derive(Debug, Clone, Copy)]
pub struct Inputs<'a, T> {
    pub set: Piece,
    pub load: Piece,
    /// Command that a sampling governor's actuator holds.
    pub held: T,
    pub past: &'a Past<T>,
    /// Times between which the past is looked up.
    pub within: [f64; 2],
}

impl<T: Scalar> Inputs<'_, T> {
    /// At a time.
    #[inline(always)]
    pub fn at(&self, equations: &Equations<T>, time: T) -> Input<T> {
        let (t, elements) = (&equations.terms, &equations.elements);
        let zero = time.constant(0.0);
        let (command, command_slope) = if elements.delayed {
            let past = time - t.t_d;
            self.past.at(past, past.value().max(self.within[0]).min(self.within[1]))
        } else if elements.sampled {
            (self.held, zero)
        } else {
            (zero, zero)
        };
        let (set, set_slope, load, load_slope) = self.held_inputs(equations, time);
        Input { set, set_slope, load, load_slope, command, command_slope }
    }

    /// At a time, without derivatives.
    pub fn value_at(&self, equations: &Equations<f64>, time: f64) -> Input<f64> {
        let (t, elements) = (&equations.terms, &equations.elements);
        let (command, command_slope) = if elements.delayed {
            let past = time - t.t_d;
            self.past.value_at(past, past.max(self.within[0]).min(self.within[1]))
        } else if elements.sampled {
            (self.held.value(), 0.0)
        } else {
            (0.0, 0.0)
        };
        let (set, set_slope, load, load_slope) = self.held_inputs(equations, time);
        Input { set, set_slope, load, load_slope, command, command_slope }
    }

    #[inline(always)]
    fn held_inputs<U: Scalar>(&self, equations: &Equations<U>, time: U) -> (U, U, U, U) {
        let (t, zero) = (&equations.terms, time.constant(0.0));
        let (set, set_slope) = if equations.elements.sampled {
            (zero, zero)
        } else {
            (t.s_u * self.set.at(time - t.t_set), t.s_u * self.set.slope)
        };
        if !equations.elements.loaded {
            return (set, set_slope, zero, zero);
        }
        (set, set_slope, t.load_gain * self.load.at(time), t.load_gain * self.load.slope)
    }
}

/// A step of the classical Runge-Kutta method.
#[inline(always)]
pub fn step<T: Scalar>(
    equations: &Equations<T>,
    input: impl Fn(T) -> Input<T>,
    start: T,
    length: T,
    state: &State<T>,
    mode: Mode,
) -> State<T> {
    let (mut probe, mut end) = (*state, *state);
    for (at, next, weight) in [(0.0, 0.5, 1.0), (0.5, 0.5, 2.0), (0.5, 1.0, 2.0), (1.0, 0.0, 1.0)] {
        let rates = equations.flow(&input(start + length * at), &probe, mode).rates;
        end = end.after(length * (weight / 6.0), &rates);
        probe = state.after(length * next, &rates);
    }
    end
}
