//! Reduction gear (eq. 3.6, 3.7).

/// Couples the engine to the slower propeller shaft.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gearbox {
    /// Engine speed over shaft speed.
    pub ratio: f64,
    /// Transmission efficiency.
    pub efficiency: f64,
}

impl Gearbox {
    /// Shaft torque [Nm] at a brake torque [Nm].
    #[inline(always)]
    #[must_use]
    pub fn shaft_torque(&self, brake_torque: f64) -> f64 {
        brake_torque * self.ratio * self.efficiency
    }
}
