//! State of the drive train between two events.

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
    /// The state after `time` at a constant `rate`.
    #[inline(always)]
    #[must_use]
    pub fn after(&self, time: f64, rate: &Self) -> Self {
        let (from, by) = (self.to_array(), rate.to_array());
        Self::from_array(std::array::from_fn(|i| from[i] + time * by[i]))
    }

    /// The mean rate of a step of the classical Runge-Kutta method.
    #[inline(always)]
    #[must_use]
    pub fn runge_kutta_mean(rates: &[Self; 4]) -> Self {
        let [a, b, c, d] = rates.each_ref().map(Self::to_array);
        Self::from_array(std::array::from_fn(|i| (a[i] + 2.0 * b[i] + 2.0 * c[i] + d[i]) / 6.0))
    }

    /// The entries in the order of the fields.
    #[inline(always)]
    #[must_use]
    pub fn to_array(&self) -> [f64; STATES] {
        let Self { engine_side, propeller, twist, crank, turn, rack, charge, error, filtered, ship } = *self;
        [engine_side, propeller, twist, crank, turn, rack, charge, error, filtered, ship]
    }

    /// The state of those entries.
    #[inline(always)]
    #[must_use]
    pub fn from_array(entries: [f64; STATES]) -> Self {
        let [engine_side, propeller, twist, crank, turn, rack, charge, error, filtered, ship] = entries;
        Self { engine_side, propeller, twist, crank, turn, rack, charge, error, filtered, ship }
    }
}
