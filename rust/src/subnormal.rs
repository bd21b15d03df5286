//! Decaying states are set to zero before they become subnormal numbers, with which processors compute many times slower.
//!
//! Kernels set such states to zero at least every few dozen samples. The samples at which they do so depend on the record
//! alone, so that results do not depend on the number of threads or on vector instructions. If states were not set to
//! zero, rounding would keep a recursion at the least subnormal number until the end of a record.

/// Magnitude below which a number counts as zero: its square is still normal, and no signal or derivative is significant
/// there.
pub const LEAST: f64 = 1e-140;

/// The number, or zero if it is smaller than [`LEAST`]; NaN remains.
#[inline(always)]
#[must_use]
pub fn cut(value: f64) -> f64 {
    if value.abs() < LEAST { 0.0 } else { value }
}

/// Cut all numbers.
#[inline(always)]
pub fn cut_all(values: &mut [f64]) {
    for value in values {
        *value = cut(*value);
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // Exact on purpose.
mod tests {
    use super::*;

    #[test]
    fn only_what_is_next_to_nothing_is_cut() {
        let mut values = [1.0, -1e-139, -1e-141, f64::from_bits(1), f64::NEG_INFINITY, f64::NAN];
        cut_all(&mut values);
        assert_eq!(values[..5], [1.0, -1e-139, 0.0, 0.0, f64::NEG_INFINITY]);
        assert!(values[5].is_nan());
        assert!((LEAST * LEAST).is_normal());
    }
}
