//! Reduction gear (eq. 3.6, 3.7).

use crate::scalar::Scalar;

/// Couples the engine to the slower propeller shaft.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gearbox<T = f64> {
    /// Engine speed over shaft speed.
    pub ratio: T,
    /// Transmission efficiency.
    pub efficiency: T,
}

impl<T: Scalar> Gearbox<T> {
    /// Shaft torque [Nm] at a brake torque [Nm].
    #[inline(always)]
    #[must_use]
    pub fn shaft_torque(&self, brake_torque: T) -> T {
        brake_torque * self.ratio * self.efficiency
    }
}
