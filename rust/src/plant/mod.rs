//! The nonlinear propulsion plant in bollard pull (eq. 3.1-3.11), one file a component.

mod affine;
mod engine;
mod envelope;
mod fused;
mod gearbox;
mod governor;
mod motion;
mod power;
mod propeller;
mod shaft;

pub use affine::Affine;
pub use engine::{Engine, limited};
pub use envelope::{Constant, Cursor, Envelope, Limit, Slope, Table};
pub use fused::times_plus;
pub use gearbox::Gearbox;
pub use governor::Governor;
pub use motion::Motion;
pub use power::{Library, Polynomial, Power, Square, polynomial, power_and_slopes};
pub use propeller::Propeller;
pub use shaft::Shaft;

use std::ops::{Add, Mul};

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

/// State of the plant, or a change of it, in the units of a [`Motion`]; `T` is a number, or one with derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct State<T = f64> {
    /// Engine speed.
    pub speed: T,
    /// Integrated error of the engine speed.
    pub error: T,
}

impl State {
    /// The state plus a multiple of another.
    #[inline(always)]
    #[must_use]
    pub fn plus<const FUSED: bool>(self, other: Self, factor: f64) -> Self {
        Self {
            speed: times_plus::<FUSED>(other.speed, factor, self.speed),
            error: times_plus::<FUSED>(other.error, factor, self.error),
        }
    }
}

impl<T: Add<Output = T>> Add for State<T> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self { speed: self.speed + other.speed, error: self.error + other.error }
    }
}

impl<T: Mul<f64, Output = T>> Mul<f64> for State<T> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, factor: f64) -> Self {
        Self { speed: self.speed * factor, error: self.error * factor }
    }
}

/// Engine, governor, gearbox, shaft and propeller as one plant.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(missing_docs)]
pub struct Plant {
    pub governor: Governor,
    pub engine: Engine,
    pub gearbox: Gearbox,
    pub propeller: Propeller,
    pub shaft: Shaft,
}

impl Plant {
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
        Ok(Self {
            governor: Governor { base_rack, proportional, integral },
            engine: Engine { rack_gain, speed_gain, offset, minimum_torque },
            gearbox: Gearbox { ratio, efficiency },
            propeller: Propeller { coefficient, exponent },
            shaft: Shaft { inertia },
        })
    }
}
