//! Governor of the engine speed, proportional and integral, with an ideal actuator (eq. 3.2-3.4).

use std::ops::{Add, Mul};

/// Turns the speed error into a fuel rack position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Governor<T = f64> {
    /// Rack position without any error, `X_0` [mm].
    pub base_rack: T,
    /// Proportional gain [mm/(rev/s)].
    pub proportional: T,
    /// Integral gain [mm/rev].
    pub integral: T,
}

impl<T: Copy> Governor<T> {
    /// Rack position [mm] for a speed error [rev/s] and its integral [rev]; the arguments are numbers, or affine functions of the state.
    #[inline(always)]
    #[must_use]
    pub fn rack<Q>(&self, speed_error: Q, integrated_error: Q) -> Q
    where
        Q: Add<Output = Q> + Add<T, Output = Q> + Mul<T, Output = Q>,
    {
        speed_error * self.proportional + integrated_error * self.integral + self.base_rack
    }
}
