//! The plant's equations of motion, folded for a loop.

use super::{Affine, Limit, Plant, Power, State, limited, times_plus};

/// The equations in the units in which a loop multiplies least.
///
/// Speeds are the engine's, integrals count in units of `duration`, torques as what they add to the speed over it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    rack: Affine,
    demand: Affine,
    minimum: f64,
    /// What a brake torque of 1 Nm adds to the engine speed over `duration`, and its inverse.
    drive: f64,
    undrive: f64,
    /// What the propeller adds to the engine speed over `duration` where that is 1 rev/s; negative.
    drag: f64,
    exponent: f64,
    duration: f64,
    shaft_per_engine_speed: f64,
}

impl Motion {
    /// Fold the equations of `plant` for changes over `duration` [s].
    #[must_use]
    pub fn new(plant: &Plant, duration: f64) -> Self {
        let Plant { governor, engine, gearbox, propeller, shaft } = plant;
        let rack = governor.rack(Affine::SET_SPEED - Affine::SPEED, Affine::ERROR * duration);
        let engine_speed_from = |torque| gearbox.ratio * shaft.acceleration(torque) * duration;
        let drive = engine_speed_from(gearbox.shaft_torque(1.0));
        let shaft_per_engine_speed = 1.0 / gearbox.ratio;
        Self {
            rack,
            demand: engine.demand(rack, Affine::SPEED) * drive,
            minimum: engine.minimum_torque * drive,
            drive,
            undrive: 1.0 / drive,
            drag: -engine_speed_from(propeller.torque(shaft_per_engine_speed)),
            exponent: propeller.exponent,
            duration,
            shaft_per_engine_speed,
        }
    }

    /// The state at a shaft speed [rev/s] and an integrated error of the engine speed [rev].
    #[must_use]
    pub fn state(&self, [shaft_speed, integrated_error]: [f64; 2]) -> State {
        State { speed: shaft_speed / self.shaft_per_engine_speed, error: integrated_error / self.duration }
    }

    /// What the engine adds to the speed.
    #[inline(always)]
    #[must_use]
    pub fn push<const FUSED: bool>(&self, limit: &mut impl Limit, set_speed: f64, state: State) -> f64 {
        let maximum = self.drive * limit.torque(state.speed);
        limited(self.demand.at::<FUSED>(set_speed, state), self.minimum, maximum)
    }

    /// Change of the state under a push.
    #[inline(always)]
    #[must_use]
    pub fn change<P: Power, const FUSED: bool>(&self, push: f64, set_speed: f64, state: State) -> State {
        let power = P::of(state.speed, self.exponent);
        State { speed: times_plus::<FUSED>(self.drag, power, push), error: set_speed - state.speed }
    }

    /// What is recorded of a state and the push in it: `n_s` [rev/s], `E_n` [rev], `X_f` [mm], `M_b` [Nm].
    #[inline(always)]
    #[must_use]
    pub fn record<const FUSED: bool>(&self, push: f64, set_speed: f64, state: State) -> [f64; 4] {
        [
            state.speed * self.shaft_per_engine_speed,
            state.error * self.duration,
            self.rack.at::<FUSED>(set_speed, state),
            push * self.undrive,
        ]
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use proptest::prelude::*;

    use super::*;
    use crate::plant::{Constant, Library};

    proptest! {
        /// The components one after the other, as eq. 3.1 to 3.10 print them.
        #[test]
        fn folding_keeps_the_equations(
            n_set in 5.0..40.0_f64, n_s in -15.0..15.0_f64, e_n in -5.0..5.0_f64, limit in 100.0..2000.0_f64, p in 1.5..3.0, h in 1e-4..1.0,
        ) {
            let [i_p, i_gb, eta, a1, a2, a3, c, x_0, k_p, k_i, least]: [f64; 11] =
                [21.2, 3.0, 0.95, 27.0, -6.0, 5.0, 12.18, 13.07, 6.03, 0.603, -300.0];
            let plant = Plant::from_parameters(&[i_p, i_gb, eta, a1, a2, a3, c, p, x_0, k_p, k_i, least], "").unwrap();
            let n_e = i_gb * n_s;
            let x_f = x_0 + k_p * (n_set - n_e) + k_i * e_n;
            let m_b = (a1 * x_f + a2 * n_e + a3).min(limit).max(least);
            let acceleration = (m_b * i_gb * eta - c * n_s.signum() * n_s.abs().powf(p)) / (TAU * i_p);

            let motion = Motion::new(&plant, h);
            let state = motion.state([n_s, e_n]);
            let push = motion.push::<false>(&mut Constant(limit), n_set, state);
            let [speed, error, ..] = motion.record::<false>(push, n_set, state + motion.change::<Library, false>(push, n_set, state));
            let found = motion.record::<false>(push, n_set, state);

            let close = |found: f64, expected: f64, size: f64| (found - expected).abs() <= 1e-13 * size;
            prop_assert!(close(found[0], n_s, 15.0) && close(found[1], e_n, 5.0));
            prop_assert!(close(found[2], x_f, 200.0) && close(found[3], m_b, 5000.0));
            prop_assert!(close(speed, n_s + h * acceleration, 1000.0) && close(error, e_n + h * (n_set - n_e), 100.0));
        }
    }
}
