//! Diesel engine: brake torque, affine in rack and speed (eq. 3.5) between two limits.

/// Turns rack position and engine speed into brake torque.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Engine {
    /// Torque per rack position, A1 [Nm/mm].
    pub rack_gain: f64,
    /// Torque per engine speed at a fixed rack, A2 [Nm/(rev/s)].
    pub speed_gain: f64,
    /// A3 [Nm].
    pub offset: f64,
    /// Lowest torque [Nm], minus infinity for no limit.
    pub minimum_torque: f64,
}

impl Engine {
    /// Brake torque [Nm] before its limits.
    #[inline(always)]
    #[must_use]
    pub fn demand(&self, rack: f64, engine_speed: f64) -> f64 {
        rack * self.rack_gain + engine_speed * self.speed_gain + self.offset
    }
}

/// `demand` between `minimum` and `maximum`, of which the minimum wins; a NaN stays one.
// Written so that each line is one instruction; `f64::min` and `f64::max` would drop a NaN and cost three.
#[inline(always)]
#[must_use]
pub fn limited(demand: f64, minimum: f64, maximum: f64) -> f64 {
    let torque = if maximum < demand { maximum } else { demand };
    if minimum > torque { minimum } else { torque }
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // Exact on purpose.
mod tests {
    use super::limited;

    #[test]
    fn the_minimum_wins_over_the_maximum() {
        assert_eq!(limited(300.0, -50.0, 250.0), 250.0);
        assert_eq!(limited(-80.0, -50.0, 250.0), -50.0);
        assert_eq!(limited(0.0, 20.0, 10.0), 20.0);
        assert_eq!(limited(300.0, f64::NEG_INFINITY, f64::INFINITY), 300.0);
    }

    #[test]
    fn a_demand_that_is_not_a_number_is_not_hidden_by_the_limits() {
        assert!(limited(f64::NAN, -50.0, 250.0).is_nan());
    }
}
