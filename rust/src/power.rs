//! The power law of the propeller, n |n|^(p - 1).

/// `speed` |`speed`|^(`exponent` - 1).
#[inline(always)]
#[must_use]
#[allow(clippy::float_cmp)] // Whole exponents are exact.
pub fn power(speed: f64, exponent: f64) -> f64 {
    // The exponent is the same in all calls of a simulation, so the branch is predicted.
    match exponent {
        1.0 => speed,
        2.0 => speed * speed.abs(),
        _ => {
            let logarithm = log2(speed.abs().max(f64::MIN_POSITIVE));
            speed * exp2(logarithm * (exponent - 1.0))
        }
    }
}

/// `speed` |`speed`|^(`exponent` - 1), and its derivative.
#[inline(always)]
#[must_use]
pub fn power_and_slope(speed: f64, exponent: f64) -> [f64; 2] {
    let logarithm = log2(speed.abs().max(f64::MIN_POSITIVE));
    let slope = exp2(logarithm * (exponent - 1.0));
    [speed * slope, exponent * slope]
}

/// 2^52. Its sum with a small whole number holds that number in the low bits.
const TWO_52: f64 = 4_503_599_627_370_496.0;

/// Base-2 logarithm of a positive normal number.
///
/// The number is 2^k m with m in [sqrt(1/2), sqrt(2)), and ln m = 2 atanh(s) with s = (m - 1)/(m + 1).
#[inline(always)]
fn log2(x: f64) -> f64 {
    const SQRT_HALF: u64 = std::f64::consts::FRAC_1_SQRT_2.to_bits();
    const ONE: u64 = 1.0_f64.to_bits();
    /// 2 atanh(s) / (s ln 2) in powers of s^2, interpolated at Chebyshev nodes, with an error of at most 1.5e-17.
    const SERIES: [f64; 8] = [
        2.885_390_081_777_926_8,
        0.961_796_693_925_989_8,
        0.577_078_016_345_520_3,
        0.412_198_585_840_900_5,
        0.320_598_534_913_959_84,
        0.262_334_352_504_183,
        0.220_913_084_231_176_8,
        0.213_658_956_943_192_7,
    ];
    // The shift lets the exponent field increase at sqrt(1/2) 2^k instead of at 2^k.
    let biased = x.to_bits().wrapping_add(ONE - SQRT_HALF) >> 52;
    let k = f64::from_bits(TWO_52.to_bits() | biased) - (TWO_52 + 1023.0);
    let m = f64::from_bits(x.to_bits().wrapping_sub(biased.wrapping_sub(1023) << 52));
    let s = (m - 1.0) / (m + 1.0);
    s * polynomial(s * s, SERIES) + k
}

/// 2^y, from 2^-1022 to 2^1023: 2^k 2^f with f in [-1/2, 1/2].
#[inline(always)]
fn exp2(y: f64) -> f64 {
    /// Adding this number rounds to a whole number, which the low bits then hold in two's complement.
    const ROUND: f64 = 1.5 * TWO_52;
    /// 2^f, interpolated at Chebyshev nodes, with an error of at most 2e-17.
    const SERIES: [f64; 12] = [
        1.0,
        std::f64::consts::LN_2,
        0.240_226_506_959_101_58,
        0.055_504_108_664_821_625,
        0.009_618_129_107_587_256,
        0.001_333_355_814_640_647,
        0.000_154_035_304_637_243_53,
        1.525_273_384_155_677_3e-5,
        1.321_543_253_591_237_5e-6,
        1.017_805_708_773_394_1e-7,
        7.074_194_297_288_521e-9,
        4.455_817_908_336_064_5e-10,
    ];
    let y = y.clamp(-1022.0, 1023.0);
    let rounded = y + ROUND;
    polynomial(y - (rounded - ROUND), SERIES) * f64::from_bits(rounded.to_bits().wrapping_add(1023) << 52)
}

/// A polynomial with an even number of coefficients, the constant first.
///
/// Even and odd powers are separate: two chains of half the length have less latency.
#[inline(always)]
#[must_use]
pub fn polynomial<const N: usize>(x: f64, coefficients: [f64; N]) -> f64 {
    let square = x * x;
    let (mut even, mut odd) = (0.0_f64, 0.0_f64);
    for pair in coefficients.as_chunks::<2>().0.iter().rev() {
        even = even * square + pair[0];
        odd = odd * square + pair[1];
    }
    odd * x + even
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // Exact on purpose.
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn polynomials_agree_with_the_library(speed in -1e4..1e4_f64, small in -1e-4..1e-4_f64, exponent in 0.3..4.0) {
            for speed in [speed, small] {
                let expected = speed.abs().powf(exponent).copysign(speed);
                // The error of the logarithm's last bit is multiplied by the logarithm.
                let found = power(speed, exponent);
                prop_assert!((found - expected).abs() <= 1e-14 * expected.abs(), "{found} {expected}");
            }
        }
    }

    #[test]
    fn nothing_is_made_of_standing_still_and_what_is_not_finite_stays_so() {
        for exponent in [1.0, 2.0, 2.17] {
            assert_eq!(power(0.0, exponent), 0.0);
            assert_eq!(power(f64::NEG_INFINITY, exponent), f64::NEG_INFINITY);
            assert!(power(f64::NAN, exponent).is_nan());
        }
    }
}
