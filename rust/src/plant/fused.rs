//! Multiply and add, rounded once or twice.

/// `value factor + summand`; where the machine has an instruction for it, `FUSED`, rounded once.
#[inline(always)]
#[must_use]
pub fn times_plus<const FUSED: bool>(value: f64, factor: f64, summand: f64) -> f64 {
    if FUSED { value.mul_add(factor, summand) } else { value * factor + summand }
}
