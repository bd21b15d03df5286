//! The load's law as a function of speed, and its slope.
//!
//! Near a point with a known value, a power is cheap to compute by a series, and a ship's speed remains near that point
//! for many steps.

use crate::power::{polynomial, power_and_slope};

/// Terms of the Taylor series.
const TERMS: usize = 8;
/// Relative distance from the expansion point up to which eight terms are exact to rounding.
const REACH: f64 = 1.0 / 64.0;
/// Exponents for which eight terms are exact up to [`REACH`].
const EXPONENTS: std::ops::RangeInclusive<f64> = 0.0..=6.0;

/// `N^p + curvature (N - 1)^2 + damping (N - 1)`.
pub struct Law {
    exponent: f64,
    curvature: Option<f64>,
    damping: Option<f64>,
    /// Speed about which the power law is expanded, and its inverse.
    place: f64,
    inverse: f64,
    reach: f64,
    /// Coefficients of (1 + x)^p, these coefficients times the value at the point, and the coefficients of the slope.
    binomial: [f64; TERMS],
    value: [f64; TERMS],
    slope: [f64; TERMS],
}

impl Law {
    pub fn new(exponent: f64, curvature: Option<f64>, damping: Option<f64>) -> Self {
        let mut binomial = [1.0; TERMS];
        for k in 1..TERMS {
            binomial[k] = binomial[k - 1] * (exponent - (k - 1) as f64) / k as f64;
        }
        // With a negative reach, the series is never used.
        let reach = if EXPONENTS.contains(&exponent) { REACH } else { -1.0 };
        Self {
            exponent,
            curvature,
            damping,
            place: 1.0,
            inverse: 1.0,
            reach,
            binomial,
            value: binomial,
            slope: steepness(&binomial, 1.0),
        }
    }

    /// The law alone.
    #[inline(always)]
    pub fn value(&mut self, speed: f64) -> f64 {
        if self.exponent == 2.0 {
            self.bent(speed - 1.0, [speed * speed.abs(), 0.0])[0]
        } else {
            self.at(speed)[0]
        }
    }

    /// The law at a speed, and its slope.
    #[inline(always)]
    pub fn at(&mut self, speed: f64) -> [f64; 2] {
        let x = (speed - self.place) * self.inverse;
        let found = if x.abs() <= self.reach {
            [polynomial(x, self.value), polynomial(x, self.slope)]
        } else {
            self.moved(speed)
        };
        self.bent(speed - 1.0, found)
    }

    #[inline(always)]
    fn bent(&self, apart: f64, [mut law, mut slope]: [f64; 2]) -> [f64; 2] {
        if let Some(curvature) = self.curvature {
            let grown = apart * curvature;
            law += apart * grown;
            slope += 2.0 * grown;
        }
        if let Some(damping) = self.damping {
            law += apart * damping;
            slope += damping;
        }
        [law, slope]
    }

    /// Expand the power at another point; return value and slope there.
    #[inline(never)]
    fn moved(&mut self, speed: f64) -> [f64; 2] {
        let found = power_and_slope(speed, self.exponent);
        (self.place, self.inverse) = (speed, 1.0 / speed);
        self.value = self.binomial.map(|factor| factor * found[0]);
        self.slope = steepness(&self.value, self.inverse);
        found
    }
}

/// Coefficients of the slope.
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
