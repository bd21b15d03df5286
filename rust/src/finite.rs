//! Test of values for finiteness, as fast as they can be read.

use pulp::{Simd, WithSimd};

use crate::instruction_set::arch;

/// Tests all values without an early exit, so that the compiler vectorises the loop.
#[must_use]
pub fn all_finite(values: &[f64]) -> bool {
    arch().dispatch(AllFinite(values))
}

struct AllFinite<'a>(&'a [f64]);

impl WithSimd for AllFinite<'_> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> bool {
        self.0.iter().fold(true, |finite, value| finite & value.is_finite())
    }
}
