//! Propeller torque in bollard pull (eq. 3.8, 3.10, 3.11), with a free exponent.

use super::{Library, Power};

/// `M_p = coefficient n_s |n_s|^(exponent - 1)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Propeller {
    /// [Nm/(rev/s)^exponent]; rho D^5 `K_Q` / `eta_r` where the exponent is 2.
    pub coefficient: f64,
    /// 2 in the thesis.
    pub exponent: f64,
}

impl Propeller {
    /// Torque that the propeller takes [Nm] at a shaft speed [rev/s].
    #[must_use]
    pub fn torque(&self, shaft_speed: f64) -> f64 {
        self.coefficient * Library::of(shaft_speed, self.exponent)
    }

    /// Whether the torque goes with the square of the speed, so that a loop needs no power function.
    #[must_use]
    #[allow(clippy::float_cmp)]
    pub fn is_square(&self) -> bool {
        self.exponent == 2.0
    }
}
