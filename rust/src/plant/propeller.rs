//! Propeller torque in bollard pull (eq. 3.8, 3.10, 3.11), with a free exponent.

/// `M_p = coefficient n_s |n_s|^(exponent - 1)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Propeller {
    /// [Nm/(rev/s)^exponent]; rho D^5 `K_Q` / `eta_r` where the exponent is 2.
    pub coefficient: f64,
    /// 2 in the thesis.
    pub exponent: f64,
}

impl Propeller {
    /// Whether the torque goes with the square of the speed, so that [`Self::torque`] needs no power function.
    #[must_use]
    #[allow(clippy::float_cmp)]
    pub fn is_square(&self) -> bool {
        self.exponent == 2.0
    }

    /// Torque that the propeller takes [Nm] at a shaft speed [rev/s]; `SQUARE` only where [`Self::is_square`].
    #[inline(always)]
    #[must_use]
    pub fn torque<const SQUARE: bool>(&self, shaft_speed: f64) -> f64 {
        let power = if SQUARE {
            shaft_speed * shaft_speed.abs()
        } else {
            shaft_speed.abs().powf(self.exponent).copysign(shaft_speed)
        };
        self.coefficient * power
    }
}
