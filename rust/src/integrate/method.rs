//! Explicit one-step methods.

use crate::plant::State;

/// One step of a method.
pub trait Method {
    /// The part of a step over which `change` is taken; chosen so that the loop multiplies least.
    const UNIT: f64;

    /// The state after one step from `state`.
    ///
    /// `change(c, x)` is what a unit adds at the rate that holds at state x, a fraction c into the step; `first` is
    /// that at the start.
    fn advance(state: State, first: State, change: impl FnMut(f64, State) -> State) -> State;
}

/// Forward Euler, the method that made the thesis's virtual data.
pub struct Euler;
/// Explicit trapezoid.
pub struct Heun;
/// Classical fourth-order Runge-Kutta.
pub struct Rk4;

impl Method for Euler {
    const UNIT: f64 = 1.0;

    #[inline(always)]
    fn advance(state: State, first: State, _change: impl FnMut(f64, State) -> State) -> State {
        state + first
    }
}

impl Method for Heun {
    const UNIT: f64 = 1.0;

    #[inline(always)]
    fn advance(state: State, first: State, mut change: impl FnMut(f64, State) -> State) -> State {
        let second = change(1.0, state + first);
        state + (first + second) * 0.5
    }
}

impl Method for Rk4 {
    const UNIT: f64 = 0.5;

    #[inline(always)]
    fn advance(state: State, first: State, mut change: impl FnMut(f64, State) -> State) -> State {
        let second = change(0.5, state + first);
        let third = change(0.5, state + second);
        let fourth = change(1.0, state + (third + third));
        let middle = second + third;
        state + (first + fourth + (middle + middle)) * (1.0 / 3.0)
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // Exact on purpose.
mod tests {
    use super::*;

    /// On x' = z x over a unit step a method of order q gives the series of exp(z) up to z^q.
    fn amplification<M: Method>(z: f64) -> f64 {
        let rate = |state: State| state * (z * M::UNIT);
        let start = State { speed: 1.0, error: 1.0 };
        M::advance(start, rate(start), |_, state| rate(state)).speed
    }

    #[test]
    fn methods_reproduce_the_exponential_to_their_order() {
        for z in [-2.0_f64, -0.3, 0.1] {
            let euler = 1.0 + z;
            let heun = euler + z.powi(2) / 2.0;
            let rk4 = heun + z.powi(3) / 6.0 + z.powi(4) / 24.0;
            assert!((amplification::<Euler>(z) - euler).abs() < 1e-15);
            assert!((amplification::<Heun>(z) - heun).abs() < 1e-15);
            assert!((amplification::<Rk4>(z) - rk4).abs() < 1e-15);
        }
    }

    /// A rate that depends on time alone is integrated by the method's quadrature rule.
    #[test]
    fn methods_ask_for_the_rate_at_their_own_times() {
        let integral = |of: fn(f64) -> f64| {
            let start = State { speed: 0.0, error: 0.0 };
            let change = |unit: f64, c: f64| State { speed: of(c) * unit, error: 0.0 };
            [
                Euler::advance(start, change(Euler::UNIT, 0.0), |c, _| change(Euler::UNIT, c)).speed,
                Heun::advance(start, change(Heun::UNIT, 0.0), |c, _| change(Heun::UNIT, c)).speed,
                Rk4::advance(start, change(Rk4::UNIT, 0.0), |c, _| change(Rk4::UNIT, c)).speed,
            ]
        };
        assert_eq!(integral(|_| 1.0), [1.0, 1.0, 1.0]);
        let [euler, heun, rk4] = integral(|c| c * c * c);
        assert_eq!((euler, heun), (0.0, 0.5));
        assert!((rk4 - 0.25).abs() < 1e-15);
    }
}
