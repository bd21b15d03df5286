//! The nonlinear propulsion plant in bollard pull (eq. 3.1-3.11), one file a component.

mod affine;
mod engine;
mod envelope;
mod gearbox;
mod governor;
mod propeller;
mod shaft;

pub use affine::Affine;
pub use engine::Engine;
pub use envelope::{Constant, Cursor, Envelope, Limit, Table};
pub use gearbox::Gearbox;
pub use governor::Governor;
pub use propeller::Propeller;
pub use shaft::Shaft;

use crate::error::{Error, Result, require};

/// Names of the entries of a parameter vector, in order.
pub const PARAMETERS: [&str; 12] = [
    "inertia",
    "gear_ratio",
    "transmission_efficiency",
    "A1",
    "A2",
    "A3",
    "torque_coefficient",
    "torque_exponent",
    "X_0",
    "Kp_abs",
    "Ki_abs",
    "minimum_torque",
];

/// State of the plant, or its rate of change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct State {
    /// Shaft speed [rev/s].
    pub speed: f64,
    /// Integrated error of the engine speed [rev].
    pub error: f64,
}

impl State {
    /// The state after `step` at a constant `rate`.
    #[inline(always)]
    #[must_use]
    pub fn after(self, step: f64, rate: Self) -> Self {
        Self { speed: self.speed + step * rate.speed, error: self.error + step * rate.error }
    }
}

/// Engine, governor, gearbox, shaft and propeller as one plant.
///
/// All that is linear around the torque limit and the propeller is folded when the plant is built.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plant {
    rack: Affine,
    demand: Affine,
    engine: Engine,
    gear_ratio: f64,
    /// Acceleration of the shaft per brake torque [(rev/s2)/Nm].
    drive: f64,
    /// The propeller's coefficient gives an acceleration here, not a torque.
    drag: Propeller,
}

impl Plant {
    /// Compose the components.
    #[must_use]
    pub fn new(
        governor: Governor,
        engine: Engine,
        gearbox: Gearbox,
        propeller: Propeller,
        shaft: Shaft,
    ) -> Self {
        let engine_speed = gearbox.engine_speed(Affine::SHAFT_SPEED);
        let rack = governor.rack(Affine::SET_SPEED - engine_speed, Affine::INTEGRATED_ERROR);
        Self {
            rack,
            demand: engine.demand(rack, engine_speed),
            engine,
            gear_ratio: gearbox.ratio,
            drive: shaft.acceleration(gearbox.shaft_torque(1.0)),
            drag: Propeller { coefficient: shaft.acceleration(propeller.coefficient), ..propeller },
        }
    }

    /// Build from a vector in the order of [`PARAMETERS`]; `label` names it in messages.
    ///
    /// # Errors
    /// Where the vector has the wrong length or a value makes no sense.
    pub fn from_parameters(values: &[f64], label: &str) -> Result<Self> {
        let Ok(parameters) = <[f64; PARAMETERS.len()]>::try_from(values) else {
            return Err(Error::Invalid(format!(
                "{label} has {} values, expected {}: {}",
                values.len(),
                PARAMETERS.len(),
                PARAMETERS.join(", ")
            )));
        };
        for (name, value) in PARAMETERS.into_iter().zip(parameters) {
            let (ok, expected) = match name {
                "inertia" | "gear_ratio" | "transmission_efficiency" | "torque_exponent" => {
                    (value.is_finite() && value > 0.0, "a positive number")
                }
                "minimum_torque" => (value < f64::INFINITY, "a number, or minus infinity for no lower limit"),
                _ => (value.is_finite(), "a finite number"),
            };
            require(ok, || format!("{label}: {name} is {value}, expected {expected}"))?;
        }
        let [
            inertia,
            ratio,
            efficiency,
            rack_gain,
            speed_gain,
            offset,
            coefficient,
            exponent,
            base_rack,
            proportional,
            integral,
            minimum_torque,
        ] = parameters;
        Ok(Self::new(
            Governor { base_rack, proportional, integral },
            Engine { rack_gain, speed_gain, offset, minimum_torque },
            Gearbox { ratio, efficiency },
            Propeller { coefficient, exponent },
            Shaft { inertia },
        ))
    }

    /// Whether [`Self::rate`] may take the propeller torque as a square.
    #[must_use]
    pub fn is_square(&self) -> bool {
        self.drag.is_square()
    }

    /// Fuel rack [mm].
    #[inline(always)]
    #[must_use]
    pub fn rack(&self, set_speed: f64, state: State) -> f64 {
        self.rack.at(set_speed, state)
    }

    /// Brake torque [Nm].
    #[inline(always)]
    #[must_use]
    pub fn torque(&self, limit: &mut impl Limit, set_speed: f64, state: State) -> f64 {
        self.engine.limited(self.demand.at(set_speed, state), limit.torque(self.gear_ratio * state.speed))
    }

    /// Rate of change of the state under a brake torque [Nm].
    #[inline(always)]
    #[must_use]
    pub fn rate<const SQUARE: bool>(&self, torque: f64, set_speed: f64, state: State) -> State {
        State {
            speed: self.drive * torque - self.drag.torque::<SQUARE>(state.speed),
            error: set_speed - self.gear_ratio * state.speed,
        }
    }
}
