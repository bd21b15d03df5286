//! States that decay are cut to zero before they become subnormal numbers, with which a processor computes many times slower.
//!
//! Kernels cut at places that depend on the record alone, every few dozen samples, so that threads and vectors change
//! nothing. A recursion that rounds would otherwise stay at the least subnormal number for the rest of a record.

/// What is smaller counts as zero: its square is still a normal number, and no signal or derivative means anything there.
pub const LEAST: f64 = 1e-140;

/// The number, or zero where it is smaller than [`LEAST`]; NaN stays.
#[inline(always)]
#[must_use]
pub fn cut(value: f64) -> f64 {
    if value.abs() < LEAST { 0.0 } else { value }
}

/// Cut all of them.
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
