//! Whether values are all finite, at the speed at which they are read.

use multiversion::multiversion;

/// All of them, without an early exit: that much the compiler turns into vector code.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
#[must_use]
pub fn all_finite(values: &[f64]) -> bool {
    values.iter().fold(true, |finite, value| finite & value.is_finite())
}
