//! Cosine of an angle in turns, without branches or tables, since simulations of single firings mostly compute cosines.

use std::f64::consts::TAU;

use crate::power::polynomial;

/// 1.5 2^52: adding it rounds to a whole number.
const ROUND: f64 = 6_755_399_441_055_744.0;

/// Cosine of an angle [rev], to 3e-16; not a number beyond 2^51 turns or so.
///
/// The nearest whole turn is taken off, which is exact, and what is left folded onto the quarter turn about zero, where
/// the sine is s times a polynomial in s^2.
#[inline(always)]
#[must_use]
pub fn cosine(turns: f64) -> f64 {
    sine_of_quarter(0.25 - from_whole(turns).abs())
}

/// Angle from the nearest whole turn [rev].
#[inline(always)]
fn from_whole(turns: f64) -> f64 {
    turns - ((turns + ROUND) - ROUND)
}

/// Sine of an angle of at most a quarter turn [rev].
#[inline(always)]
fn sine_of_quarter(s: f64) -> f64 {
    /// sin(2 pi s) / s in powers of s^2, interpolated at Chebyshev nodes; off by 2e-21 at most.
    const SERIES: [f64; 10] = [
        TAU,
        -41.341_702_240_399_76,
        81.605_249_276_075_06,
        -76.705_859_753_060_72,
        42.058_693_944_828_704,
        -15.094_642_572_701_975,
        3.819_952_434_866_809,
        -0.718_118_921_891_065_9,
        0.104_183_090_870_646_48,
        -0.011_683_082_881_307_493,
    ];
    s * polynomial(s * s, SERIES)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn it_is_the_cosine_of_the_library(part in -1.0..1.0_f64, turns in -1_000_000..1_000_000_i32) {
            prop_assert!((cosine(part) - (TAU * part).cos()).abs() < 1e-15);
            // Whole turns change nothing; the sum is rounded, which the expected angle must be too.
            let sum = part + f64::from(turns);
            prop_assert!((cosine(sum) - (TAU * (sum - f64::from(turns))).cos()).abs() < 1e-15);
        }
    }

    #[test]
    #[allow(clippy::float_cmp)] // Exact on purpose.
    fn quarters_of_a_turn_are_exact_and_what_is_not_finite_is_not_hidden() {
        for (turns, expected) in [(0.0, 1.0), (0.25, 0.0), (0.5, -1.0), (0.75, 0.0), (7.0, 1.0)] {
            assert_eq!(cosine(turns), expected, "{turns}");
        }
        assert!(cosine(f64::NAN).is_nan() && cosine(f64::INFINITY).is_nan());
    }
}
