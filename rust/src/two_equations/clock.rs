//! Effects of a sampling governor besides its delay: the rectangle rule of its integral, and the ripple of its held command.

use super::dual::Dual;

/// Ratios of dead time to sample period. Below the first ratio, the phase of the ripple at the samples is known, and the
/// ripple is computed. Above the second ratio, the phase is unknown, and the mean over all phases is used, which is zero.
const KNOWN: [f64; 2] = [0.5, 1.0];

/// Derivative gain of the governor that represents the rectangle rule of its integral, for a period of twice `held`. With
/// `x = s held`, the rectangle rule is `(K_i / s) cosh x` and `K_p sinh(x) / x`; the hold's mean is `cosh(x / sqrt(3))`
/// for both terms.
pub fn summed(integral: Dual, held: Dual) -> Dual {
    integral * held * held * (1.0 / 3.0)
}

/// Ripple of the speed at the governor's samples, divided by the fuel's slope and the inverse inertia [s^2]. Half of the
/// sample period is part of the dead time `dead`; a lag follows.
///
/// Images of the command at multiples z of the sample rate alias through the lag and the inertia at the sampling instants:
/// the sum of `exp(-z t) / (z^2 (1 + z lag))`, with t the dead time without half a period.
pub fn ripple(period: Dual, dead: Dual, lag: Dual) -> Dual {
    let late = dead * period.inverse() + -0.5;
    let [known, unknown] = KNOWN;
    if late.value >= unknown {
        return Dual::new(0.0);
    }
    let after = late * -1.0 + 1.0;
    let mut found = period * period * (after * (after + -1.0) + 1.0 / 6.0) * -0.5;
    found = found + lag * period * (after + -0.5);
    if lag.value > 0.0 {
        let ratio = period * lag.inverse();
        let (since, whole) = ((after * ratio * -1.0).exponential(), (ratio * -1.0).exponential());
        found = found + lag * period * since * (whole * -1.0 + 1.0).inverse() - lag * lag;
    }
    if late.value > known {
        let part = (late + -known) * (1.0 / (unknown - known));
        found = found * (part * part * (part * 2.0 + -3.0) + 1.0);
    }
    found
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use proptest::prelude::*;

    use super::*;
    use crate::two_equations::equations::COUNT;

    proptest! {
        #[test]
        fn the_ripple_is_the_sum_of_the_images(period in 0.01..0.2_f64, late in 0.0..0.5_f64, lag in 0.0..0.2_f64) {
            let found = ripple(Dual::new(period), Dual::new(period * (late + 0.5)), Dual::new(lag));
            let turn = TAU / period;
            // exp(-z t) / (z^2 (1 + z lag)) and its conjugate.
            let sum = (1..20_000).map(|k| {
                let (z, angle) = (turn * f64::from(k), TAU * f64::from(k) * late);
                -2.0 * (angle.cos() - angle.sin() * z * lag) / (z * z * (1.0 + z * z * lag * lag))
            });
            let size = (0.5 * period).powi(2);
            prop_assert!((found.value - sum.sum::<f64>()).abs() < 1e-4 * size);
        }

        #[test]
        fn its_derivatives_are_those_of_a_fine_difference(
            period in 0.01..0.2_f64, late in 0.03..2.0_f64, lag in 0.001..0.2_f64,
        ) {
            prop_assume!((late - late.round()).abs() > 1e-3);
            let dead = period * (late + 0.5);
            let mut values = [0.0; COUNT];
            values[..3].copy_from_slice(&[period, dead, lag]);
            let q = |place| Dual::parameter(&values, place);
            let found = ripple(q(0), q(1), q(2));
            for place in 0..3 {
                let h = 1e-6 * values[place];
                let at = |by: f64| {
                    let mut moved = values;
                    moved[place] += by;
                    ripple(Dual::new(moved[0]), Dual::new(moved[1]), Dual::new(moved[2])).value
                };
                let slope = (at(h) - at(-h)) / (2.0 * h);
                let size = (0.5 * period).powi(2) / values[place];
                prop_assert!((found.slopes[place] - slope).abs() < 1e-4 * (size + slope.abs()), "{place}");
            }
        }
    }
}
