//! Rotating shaft line: the balance of torques (eq. 3.1).

use std::f64::consts::TAU;

/// Everything that turns, as one inertia at the propeller.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shaft {
    /// Mass moment of inertia `I_p` [kg m2].
    pub inertia: f64,
}

impl Shaft {
    /// Change of shaft speed [rev/s2] under a torque [Nm].
    #[must_use]
    pub fn acceleration(&self, torque: f64) -> f64 {
        torque / (TAU * self.inertia)
    }
}
