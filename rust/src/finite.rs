//! Whether values are all finite, at the speed at which they are read.

use pulp::{Simd, WithSimd};

use crate::instruction_set::arch;

/// All of them, without an early exit: that much the compiler turns into vector code.
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
