//! State of the drive train between two events.

use crate::scalar::Scalar;

/// Number of entries of a [`State`].
pub const STATES: usize = 10;

/// State of the drive train, or its rate of change.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct State<T = f64> {
    /// Speed of the shaft on the engine's side of the gauge [rev/s].
    pub engine_side: T,
    /// Speed of the propeller [rev/s].
    pub propeller: T,
    /// By how much the engine's side leads [rev].
    pub twist: T,
    /// Angle of the crankshaft [rev].
    pub crank: T,
    /// Angle of the propeller [rev].
    pub turn: T,
    /// Fuel rack behind the actuator's lag [mm].
    pub rack: T,
    /// The rack that the charge air is good for [mm].
    pub charge: T,
    /// Integrated error of the engine speed [rev].
    pub error: T,
    /// Filtered engine speed [rev/s].
    pub filtered: T,
    /// Speed of the ship in the direction of the thrust [m/s].
    pub ship: T,
}

impl<T: Scalar> State<T> {
    /// The state after `time` at a constant `rate`.
    // Entry by entry: loops over them are not inlined, and what is not inlined is not compiled for the machine's vectors.
    #[inline(always)]
    #[must_use]
    pub fn after(&self, time: T, rate: &Self) -> Self {
        Self {
            engine_side: self.engine_side + rate.engine_side * time,
            propeller: self.propeller + rate.propeller * time,
            twist: self.twist + rate.twist * time,
            crank: self.crank + rate.crank * time,
            turn: self.turn + rate.turn * time,
            rack: self.rack + rate.rack * time,
            charge: self.charge + rate.charge * time,
            error: self.error + rate.error * time,
            filtered: self.filtered + rate.filtered * time,
            ship: self.ship + rate.ship * time,
        }
    }

    /// What has decayed cut to zero.
    #[inline(always)]
    #[must_use]
    pub fn cut(&self) -> Self {
        Self {
            engine_side: self.engine_side.cut(),
            propeller: self.propeller.cut(),
            twist: self.twist.cut(),
            crank: self.crank.cut(),
            turn: self.turn.cut(),
            rack: self.rack.cut(),
            charge: self.charge.cut(),
            error: self.error.cut(),
            filtered: self.filtered.cut(),
            ship: self.ship.cut(),
        }
    }

    /// The state plus so many times another.
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
}

impl State {
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
