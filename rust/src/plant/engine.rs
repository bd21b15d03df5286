//! Diesel engine: brake torque, affine in rack and speed (eq. 3.5) between two limits.

use super::Affine;

/// Turns rack position and engine speed into brake torque.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Engine {
    /// Torque per rack position, A1 [Nm/mm].
    pub rack_gain: f64,
    /// Torque per engine speed at a fixed rack, A2 [Nm/(rev/s)].
    pub speed_gain: f64,
    /// A3 [Nm].
    pub offset: f64,
    /// What the torque never falls below [Nm], minus infinity for no such limit.
    pub minimum_torque: f64,
}

impl Engine {
    /// Brake torque [Nm] before its limits.
    #[must_use]
    pub fn demand(&self, rack: Affine, engine_speed: Affine) -> Affine {
        rack * self.rack_gain + engine_speed * self.speed_gain + self.offset
    }

    /// Brake torque [Nm] between the envelope's torque at the present speed and the minimum; a NaN stays one.
    #[inline(always)]
    #[must_use]
    pub fn limited(&self, demand: f64, envelope: f64) -> f64 {
        let torque = if envelope < demand { envelope } else { demand };
        if torque < self.minimum_torque { self.minimum_torque } else { torque }
    }
}
