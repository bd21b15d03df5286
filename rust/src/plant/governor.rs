//! Governor of the engine speed, proportional and integral, with an ideal actuator (eq. 3.2-3.4).

use super::Affine;

/// Turns the speed error into a fuel rack position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Governor {
    /// Rack position without any error, `X_0` [mm].
    pub base_rack: f64,
    /// Proportional gain [mm/(rev/s)].
    pub proportional: f64,
    /// Integral gain [mm/rev].
    pub integral: f64,
}

impl Governor {
    /// Rack position [mm] for a speed error [rev/s] and its integral [rev].
    #[must_use]
    pub fn rack(&self, speed_error: Affine, integrated_error: Affine) -> Affine {
        speed_error * self.proportional + integrated_error * self.integral + self.base_rack
    }
}
