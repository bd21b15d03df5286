//! State of the drive train between two events.

use crate::subnormal::cut;

/// Number of entries of a [`State`].
pub const STATES: usize = 10;

/// State of the drive train, or its rate of change.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct State {
    /// Speed of the shaft on the engine's side of the gauge [rev/s].
    pub engine_side: f64,
    /// Speed of the propeller [rev/s].
    pub propeller: f64,
    /// By how much the engine's side leads [rev].
    pub twist: f64,
    /// Angle of the crankshaft [rev].
    pub crank: f64,
    /// Angle of the propeller [rev].
    pub turn: f64,
    /// Fuel rack behind the actuator's lag [mm].
    pub rack: f64,
    /// The rack that the charge air is good for [mm].
    pub charge: f64,
    /// Integrated error of the engine speed [rev].
    pub error: f64,
    /// Filtered engine speed [rev/s].
    pub filtered: f64,
    /// Speed of the ship in the direction of the thrust [m/s].
    pub ship: f64,
}

impl State {
    /// The state plus so many times another.
    // Entry by entry: loops over them are not inlined, and what is not inlined is not compiled for the machine's vectors.
    #[inline(always)]
    #[must_use]
    pub fn plus(&self, factor: f64, other: &Self) -> Self {
        Self {
            engine_side: self.engine_side + other.engine_side * factor,
            propeller: self.propeller + other.propeller * factor,
            twist: self.twist + other.twist * factor,
            crank: self.crank + other.crank * factor,
            turn: self.turn + other.turn * factor,
            rack: self.rack + other.rack * factor,
            charge: self.charge + other.charge * factor,
            error: self.error + other.error * factor,
            filtered: self.filtered + other.filtered * factor,
            ship: self.ship + other.ship * factor,
        }
    }

    /// What has decayed cut to zero.
    #[inline(always)]
    #[must_use]
    pub fn cut(&self) -> Self {
        Self::from_array(self.to_array().map(cut))
    }

    /// The entries in the order of the fields.
    #[must_use]
    pub fn to_array(&self) -> [f64; STATES] {
        let Self { engine_side, propeller, twist, crank, turn, rack, charge, error, filtered, ship } = *self;
        [engine_side, propeller, twist, crank, turn, rack, charge, error, filtered, ship]
    }

    /// The state of those entries.
    #[must_use]
    pub fn from_array(entries: [f64; STATES]) -> Self {
        let [engine_side, propeller, twist, crank, turn, rack, charge, error, filtered, ship] = entries;
        Self { engine_side, propeller, twist, crank, turn, rack, charge, error, filtered, ship }
    }
}
