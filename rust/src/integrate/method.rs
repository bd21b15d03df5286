//! Explicit one-step methods.

use crate::plant::State;

/// One step of a method.
pub trait Method {
    /// The state after `step`; `first` is the rate at its start, `rate(c, x)` the rate at state x a fraction c into it.
    fn advance(state: State, first: State, step: f64, rate: impl FnMut(f64, State) -> State) -> State;
}

/// Forward Euler, the method that made the thesis's virtual data.
pub struct Euler;
/// Explicit trapezoid.
pub struct Heun;
/// Classical fourth-order Runge-Kutta.
pub struct Rk4;

impl Method for Euler {
    #[inline(always)]
    fn advance(state: State, first: State, step: f64, _rate: impl FnMut(f64, State) -> State) -> State {
        state.after(step, first)
    }
}

impl Method for Heun {
    #[inline(always)]
    fn advance(state: State, first: State, step: f64, mut rate: impl FnMut(f64, State) -> State) -> State {
        let second = rate(1.0, state.after(step, first));
        state.after(step / 2.0, first.after(1.0, second))
    }
}

impl Method for Rk4 {
    #[inline(always)]
    fn advance(state: State, first: State, step: f64, mut rate: impl FnMut(f64, State) -> State) -> State {
        let half = step / 2.0;
        let second = rate(0.5, state.after(half, first));
        let third = rate(0.5, state.after(half, second));
        let fourth = rate(1.0, state.after(step, third));
        let ends = first.after(1.0, fourth);
        let middle = second.after(1.0, third);
        state.after(step / 6.0, ends.after(2.0, middle))
    }
}
