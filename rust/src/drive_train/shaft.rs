//! Shaft between two inertias, rigid or flexible; the strain gauge sits between them.

use std::f64::consts::TAU;

/// Two inertias and what joins them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shaft {
    /// Engine and gearbox, seen from the propeller [kg m2].
    pub engine_side: f64,
    /// Propeller, shaft and entrained water [kg m2].
    pub propeller_side: f64,
    /// [Nm/rad], infinity for a rigid shaft.
    pub stiffness: f64,
    /// [Nm s/rad].
    pub damping: f64,
}

/// What the shaft makes of the torques on it.
#[derive(Debug, Clone, Copy)]
pub struct Answer {
    /// Torque at the gauge [Nm].
    pub gauge: f64,
    /// Change of speed on the engine's side [rev/s2].
    pub engine_side: f64,
    /// Change of speed on the propeller's side [rev/s2].
    pub propeller_side: f64,
}

impl Shaft {
    /// Answer to the gearbox's and the propeller's torque [Nm] at a twist [rev] that changes at a slip [rev/s].
    #[inline(always)]
    #[must_use]
    pub fn answer(&self, drive: f64, load: f64, twist: f64, slip: f64) -> Answer {
        if self.stiffness.is_finite() {
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
    pub fn twist(&self, gauge: f64) -> f64 {
        gauge / (self.stiffness * TAU)
    }
}
