//! The load's law of the speed, and its slope.
//!
//! A power is short to compute near a place where it is known, and a ship's speed stays near for many steps.

use std::f64::consts::LN_2;

use crate::power::{polynomial, power_and_slopes};
use crate::scalar::Scalar;

/// Terms of the series about a place.
const TERMS: usize = 8;
/// Distance from a place, over it, up to which eight terms are exact to rounding.
const REACH: f64 = 1.0 / 64.0;
/// Exponents for which they are.
const EXPONENTS: std::ops::RangeInclusive<f64> = 0.0..=6.0;
/// ln(1 + x) / x.
const LOGARITHM: [f64; TERMS] = [1.0, -0.5, 1.0 / 3.0, -0.25, 0.2, -1.0 / 6.0, 1.0 / 7.0, -0.125];

/// `N^p + curvature (N - 1)^2 + damping (N - 1)`.
pub struct Law<T> {
    exponent: T,
    curvature: Option<T>,
    damping: Option<T>,
    /// Place of the series, one over it, and the logarithm there.
    place: f64,
    inverse: f64,
    logarithm: f64,
    reach: f64,
    /// Of (1 + x)^p, and of that times the value at the place and its slope.
    binomial: [f64; TERMS],
    value: [f64; TERMS],
    slope: [f64; TERMS],
}

impl Law<f64> {
    /// The law alone.
    #[inline(always)]
    pub fn value(&mut self, speed: f64) -> f64 {
        if self.exponent == 2.0 {
            self.bent(speed - 1.0, [speed * speed.abs(), 0.0])[0]
        } else {
            self.at(speed)[0]
        }
    }
}

impl<T: Scalar> Law<T> {
    pub fn new(exponent: T, curvature: Option<T>, damping: Option<T>) -> Self {
        let p = exponent.value();
        let mut binomial = [1.0; TERMS];
        for k in 1..TERMS {
            binomial[k] = binomial[k - 1] * (p - (k - 1) as f64) / k as f64;
        }
        // Nothing is within a distance less than zero.
        let reach = if EXPONENTS.contains(&p) { REACH } else { -1.0 };
        Self {
            exponent,
            curvature,
            damping,
            place: 1.0,
            inverse: 1.0,
            logarithm: 0.0,
            reach,
            binomial,
            value: binomial,
            slope: steepness(&binomial, 1.0),
        }
    }

    /// The law at a speed, and its slope; the slope's own derivatives are good to a millionth.
    #[inline(always)]
    pub fn at(&mut self, speed: T) -> [T; 2] {
        let n = speed.value();
        let x = (n - self.place) * self.inverse;
        let [value, steepness, logarithm] = if x.abs() <= self.reach {
            let logarithm = self.logarithm + x * polynomial(x, LOGARITHM);
            [polynomial(x, self.value), polynomial(x, self.slope), logarithm]
        } else {
            self.moved(n)
        };
        let law = speed.function_with(self.exponent, value, [steepness, value * logarithm]);
        let x = (n - self.place) * self.inverse;
        let over_speed = self.inverse * (1.0 - x + x * x);
        let bend = (self.exponent.value() - 1.0) * steepness * over_speed;
        let by_exponent = steepness * logarithm + value * over_speed;
        let slope = speed.function_with(self.exponent, steepness, [bend, by_exponent]);
        self.bent(speed + -1.0, [law, slope])
    }

    #[inline(always)]
    fn bent(&self, apart: T, [mut law, mut slope]: [T; 2]) -> [T; 2] {
        if let Some(curvature) = self.curvature {
            let grown = apart * curvature;
            law = law.plus_product(apart, grown);
            slope = slope.plus(grown, 2.0);
        }
        if let Some(damping) = self.damping {
            law = law.plus_product(apart, damping);
            slope = slope + damping;
        }
        [law, slope]
    }

    /// Know the power at another place: value, slope and logarithm there.
    #[inline(never)]
    fn moved(&mut self, speed: f64) -> [f64; 3] {
        let found = power_and_slopes(speed, self.exponent.value());
        (self.place, self.inverse) = (speed, 1.0 / speed);
        self.logarithm = speed.abs().max(f64::MIN_POSITIVE).log2() * LN_2;
        self.value = self.binomial.map(|factor| factor * found[0]);
        self.slope = steepness(&self.value, self.inverse);
        [found[0], found[1], self.logarithm]
    }
}

/// Terms of the slope.
fn steepness(value: &[f64; TERMS], inverse: f64) -> [f64; TERMS] {
    std::array::from_fn(|k| value.get(k + 1).map_or(0.0, |next| next * (k + 1) as f64 * inverse))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn the_series_is_the_power(p in 0.5..6.0_f64, start in 0.3..2.0_f64, x in -REACH..REACH) {
            let mut law = Law::new(p, None, None);
            law.moved(start);
            let n = start * (1.0 + x);
            let [value, slope] = law.at(n);
            prop_assert_eq!(law.place.to_bits(), start.to_bits());
            prop_assert!((value - n.powf(p)).abs() < 1e-13 * value, "{} {}", value, n.powf(p));
            prop_assert!((slope - p * n.powf(p - 1.0)).abs() < 1e-11 * slope);
        }
    }
}
