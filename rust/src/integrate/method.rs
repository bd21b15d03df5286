//! Explicit one-step methods.

use crate::plant::State;

/// What a method asks the equations for.
///
/// A trait, not a closure: a closure that is not inlined would not be compiled for the machine's vectors.
pub trait Change {
    /// What a unit adds at the rate that holds at a state, a fraction `passed` into the step.
    fn over<const FUSED: bool>(&mut self, passed: f64, state: State) -> State;
}

/// One step of a method.
pub trait Method {
    /// The part of a step over which `change` is taken; chosen so that the loop multiplies least.
    const UNIT: f64;

    /// The state after one step from `state`.
    ///
    /// `change.over(c, x)` is what a unit adds at the rate that holds at state x, a fraction c into the step; `first` is
    /// that at the start.
    fn advance<const FUSED: bool>(state: State, first: State, change: &mut impl Change) -> State;
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
    fn advance<const FUSED: bool>(state: State, first: State, _change: &mut impl Change) -> State {
        state + first
    }
}

impl Method for Heun {
    const UNIT: f64 = 1.0;

    #[inline(always)]
    fn advance<const FUSED: bool>(state: State, first: State, change: &mut impl Change) -> State {
        let second = change.over::<FUSED>(1.0, state + first);
        state.plus::<FUSED>(first + second, 0.5)
    }
}

impl Method for Rk4 {
    const UNIT: f64 = 0.5;

    #[inline(always)]
    fn advance<const FUSED: bool>(state: State, first: State, change: &mut impl Change) -> State {
        let second = change.over::<FUSED>(0.5, state + first);
        let third = change.over::<FUSED>(0.5, state + second);
        let fourth = change.over::<FUSED>(1.0, state + (third + third));
        let middle = second + third;
        // The fourth rate is known last, so it is added last.
        state.plus::<FUSED>(first + (middle + middle), 1.0 / 3.0).plus::<FUSED>(fourth, 1.0 / 3.0)
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // Exact on purpose.
mod tests {
    use super::*;

    /// The equations as a function of the fraction passed and the state.
    struct By<F>(F);

    impl<F: Fn(f64, State) -> State> Change for By<F> {
        fn over<const FUSED: bool>(&mut self, passed: f64, state: State) -> State {
            (self.0)(passed, state)
        }
    }

    fn step<M: Method>(start: State, change: impl Fn(f64, State) -> State) -> f64 {
        M::advance::<false>(start, change(0.0, start), &mut By(change)).speed
    }

    /// On x' = z x over a unit step a method of order q gives the series of exp(z) up to z^q.
    fn amplification<M: Method>(z: f64) -> f64 {
        let z = z * M::UNIT;
        let rate = |_, state: State| State { speed: state.speed * z, error: state.error * z };
        step::<M>(State { speed: 1.0, error: 1.0 }, rate)
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
        fn integral<M: Method>(of: fn(f64) -> f64) -> f64 {
            let change = |c, _| State { speed: of(c) * M::UNIT, error: 0.0 };
            step::<M>(State { speed: 0.0, error: 0.0 }, change)
        }
        let integrals = |of| [integral::<Euler>(of), integral::<Heun>(of), integral::<Rk4>(of)];
        assert!(integrals(|_| 1.0).iter().all(|one| (one - 1.0).abs() < 1e-15));
        let [euler, heun, rk4] = integrals(|c| c * c * c);
        assert_eq!((euler, heun), (0.0, 0.5));
        assert!((rk4 - 0.25).abs() < 1e-15);
    }
}
