//! The ship's own motion ahead: thrust against a resistance that goes with the square of the speed.

use crate::scalar::Scalar;

/// One degree of freedom, or none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ship<T = f64> {
    /// With the water that moves along [kg]; infinity for a ship that is held.
    pub mass: T,
    /// [N/(m/s)^2].
    pub resistance: T,
}

impl<T: Scalar> Ship<T> {
    /// Change of speed [m/s2] under a thrust [N] at a speed [m/s].
    #[inline(always)]
    #[must_use]
    pub fn acceleration(&self, thrust: T, speed: T) -> T {
        if self.mass.value().is_finite() {
            (thrust - self.resistance * speed.square()) / self.mass
        } else {
            thrust.constant(0.0)
        }
    }
}
