//! The ship's own motion ahead: thrust against a resistance that goes with the square of the speed.

/// One degree of freedom, or none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ship {
    /// With the water that moves along [kg]; infinity for a ship that is held.
    pub mass: f64,
    /// [N/(m/s)^2].
    pub resistance: f64,
}

impl Ship {
    /// Change of speed [m/s2] under a thrust [N] at a speed [m/s].
    #[inline(always)]
    #[must_use]
    pub fn acceleration(&self, thrust: f64, speed: f64) -> f64 {
        if self.mass.is_finite() { (thrust - self.resistance * speed * speed.abs()) / self.mass } else { 0.0 }
    }
}
