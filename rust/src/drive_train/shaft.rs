//! Shaft between two inertias, rigid or flexible; the strain gauge sits between them.

use std::f64::consts::TAU;

use crate::scalar::Scalar;

/// Two inertias and what joins them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shaft<T = f64> {
    /// Engine and gearbox, seen from the propeller [kg m2].
    pub engine_side: T,
    /// Propeller, shaft and entrained water [kg m2].
    pub propeller_side: T,
    /// [Nm/rad], infinity for a rigid shaft.
    pub stiffness: T,
    /// [Nm s/rad].
    pub damping: T,
}

/// What the shaft makes of the torques on it.
#[derive(Debug, Clone, Copy)]
pub struct Answer<T = f64> {
    /// Torque at the gauge [Nm].
    pub gauge: T,
    /// Change of speed on the engine's side [rev/s2].
    pub engine_side: T,
    /// Change of speed on the propeller's side [rev/s2].
    pub propeller_side: T,
}

impl<T: Scalar> Shaft<T> {
    /// Answer to the gearbox's and the propeller's torque [Nm] at a twist [rev] that changes at a slip [rev/s].
    #[inline(always)]
    #[must_use]
    pub fn answer(&self, drive: T, load: T, twist: T, slip: T) -> Answer<T> {
        if self.stiffness.value().is_finite() {
            let gauge = (self.stiffness * twist + self.damping * slip) * TAU;
            Answer {
                gauge,
                engine_side: (drive - gauge) / (self.engine_side * TAU),
                propeller_side: (gauge - load) / (self.propeller_side * TAU),
            }
        } else {
            let inertia = self.engine_side + self.propeller_side;
            let rate = (drive - load) / (inertia * TAU);
            Answer {
                gauge: load + self.propeller_side / inertia * (drive - load),
                engine_side: rate,
                propeller_side: rate,
            }
        }
    }

    /// The twist at which the gauge shows a torque at rest [rev].
    #[must_use]
    pub fn twist(&self, gauge: T) -> T {
        gauge / (self.stiffness * TAU)
    }
}
