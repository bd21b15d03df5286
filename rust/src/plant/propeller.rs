//! Propeller torque in bollard pull (eq. 3.8, 3.10, 3.11), with a free exponent.

use crate::scalar::Scalar;

/// `M_p = coefficient n_s |n_s|^(exponent - 1)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Propeller<T = f64> {
    /// [Nm/(rev/s)^exponent]; rho D^5 `K_Q` / `eta_r` where the exponent is 2.
    pub coefficient: T,
    /// 2 in the thesis.
    pub exponent: T,
}

impl<T: Scalar> Propeller<T> {
    /// Torque that the propeller takes [Nm] at a shaft speed [rev/s].
    #[inline(always)]
    #[must_use]
    pub fn torque(&self, shaft_speed: T) -> T {
        self.coefficient * shaft_speed.power(self.exponent)
    }
}

impl Propeller {
    /// Whether the torque goes with the square of the speed, so that a loop needs no power function.
    #[must_use]
    #[allow(clippy::float_cmp)]
    pub fn is_square(&self) -> bool {
        self.exponent == 2.0
    }
}
