//! Parameter vector of the drive train and its checks.

use crate::error::{Error, Result, require};

use super::engine::Engine;
use super::gearbox::Gearbox;
use super::governor::Timing;
use super::motion::{Actuator, DriveTrain};
use super::propeller::Quadrants;
use super::shaft::Shaft;
use super::ship::Ship;
use super::{Governor, Propeller};

/// Number of parameters.
const COUNT: usize = 45;

/// Names of the entries of a parameter vector, in order: those of the plant of eq. 3.1-3.11 first.
pub const PARAMETERS: [&str; COUNT] = [
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
    "propeller_inertia",
    "shaft_stiffness",
    "shaft_damping",
    "drag_coefficient",
    "drag_exponent",
    "set_dead_time",
    "Kd_abs",
    "derivative_filter",
    "governor_period",
    "anti_windup",
    "minimum_rack",
    "maximum_rack",
    "smoke_margin",
    "turbocharger_lag",
    "fuel_dead_time",
    "fuel_lag",
    "rack_rate",
    "torque_rate",
    "firing_interval",
    "firing_width",
    "blades",
    "shaft_ripple",
    "blade_ripple",
    "blade_path",
    "inflow",
    "thrust_coefficient",
    "ship_mass",
    "ship_resistance",
    "initial_speed",
    "initial_error",
    "initial_ship_speed",
    "set_point_before",
    "crank_angle",
];

/// Tables that belong to a parameter vector, of lengths that vary.
#[derive(Debug, Clone, Default)]
pub struct Tables {
    /// Each cylinder's torque over the mean of all, in the order of firing.
    pub strength: Vec<f64>,
    /// None: bollard pull.
    pub quadrants: Option<Quadrants>,
}

/// Which numbers a parameter may be, as a test and in words.
fn expected(name: &str) -> (fn(f64) -> bool, &'static str) {
    match name {
        "inertia" | "gear_ratio" | "transmission_efficiency" | "torque_exponent" | "blade_path" => {
            (|value| value > 0.0 && value.is_finite(), "a positive number")
        }
        "shaft_stiffness" | "rack_rate" | "torque_rate" | "ship_mass" => {
            (|value| value > 0.0, "a positive number, infinity for none")
        }
        "smoke_margin" => (|value| value >= 0.0, "zero or more, infinity for none"),
        "maximum_rack" => (|value| value > f64::NEG_INFINITY, "a number, infinity for none"),
        "minimum_rack" | "minimum_torque" => {
            (|value| value < f64::INFINITY, "a number, minus infinity for none")
        }
        "governor_period" => (|value| value >= 0.0, "zero or more, infinity for once a firing"),
        "propeller_inertia" | "shaft_damping" | "set_dead_time" | "derivative_filter"
        | "turbocharger_lag" | "fuel_dead_time" | "fuel_lag" | "firing_interval" | "firing_width"
        | "blades" | "ship_resistance" => (|value| value >= 0.0 && value.is_finite(), "zero or more"),
        "anti_windup" => (|value| [0.0, 1.0].contains(&value), "0 or 1"),
        _ => (f64::is_finite, "a finite number"),
    }
}

impl DriveTrain {
    /// Build from a vector in the order of [`PARAMETERS`].
    ///
    /// # Errors
    /// Where the vector has the wrong length or a value makes no sense.
    pub fn from_parameters(values: &[f64], tables: Tables) -> Result<Self> {
        let numbers: [f64; COUNT] = values.try_into().map_err(|_| {
            Error::Invalid(format!("parameters has {} values, expected {COUNT}", values.len()))
        })?;
        for (name, value) in PARAMETERS.into_iter().zip(numbers) {
            let (fits, expected) = expected(name);
            require(fits(value), || format!("parameters: {name} is {value}, expected {expected}"))?;
        }
        let train = Self::of(&numbers, tables);
        train.require_agreement()?;
        train.require_inertias()?;
        Ok(train)
    }

    /// Check the two inertias against each other.
    fn require_inertias(&self) -> Result<()> {
        let Shaft { engine_side, propeller_side, stiffness, .. } = self.shaft;
        let (inertia, rigid) = (engine_side + propeller_side, stiffness == f64::INFINITY);
        require(engine_side > 0.0 || (engine_side == 0.0 && rigid), || {
            format!(
                "parameters: propeller_inertia is {propeller_side}, expected less than inertia, {inertia}"
            )
        })?;
        require(propeller_side > 0.0 || rigid, || {
            format!(
                "parameters: propeller_inertia is {propeller_side}, expected a positive number beside a stiffness"
            )
        })
    }

    /// Check values that depend on each other.
    fn require_agreement(&self) -> Result<()> {
        let Governor { minimum_rack, maximum_rack, derivative, filter, timing, .. } = self.governor;
        require(minimum_rack < maximum_rack, || {
            format!(
                "parameters: minimum_rack is {minimum_rack}, expected less than maximum_rack, {maximum_rack}"
            )
        })?;
        require(derivative == 0.0 || filter > 0.0, || {
            "parameters: derivative_filter is 0, expected a positive number beside a derivative gain"
                .to_owned()
        })?;
        require(self.smoke_margin == f64::INFINITY || self.turbocharger_lag > 0.0, || {
            "parameters: turbocharger_lag is 0, expected a positive number beside a smoke margin".to_owned()
        })?;
        require(self.strength.iter().all(|strength| strength.is_finite()), || {
            format!("strength is {:?}, expected finite numbers", self.strength)
        })?;
        let (width, cycle) = (self.firing_width, self.firing_interval * self.strength.len() as f64);
        require(self.firing_interval == 0.0 || (width > 0.0 && width <= cycle), || {
            format!("parameters: firing_width is {width}, expected more than 0 and at most a cycle, {cycle}")
        })?;
        require(timing != Timing::AtFiring || self.firing_interval > 0.0, || {
            "parameters: firing_interval is 0, expected a positive angle for a governor that acts once a firing"
                .to_owned()
        })
    }

    /// Build from checked numbers in the order of [`PARAMETERS`].
    fn of(numbers: &[f64; COUNT], tables: Tables) -> Self {
        // long: a line for each of the numbers, and one for where it goes.
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
            propeller_side,
            stiffness,
            damping,
            drag,
            drag_exponent,
            set_dead_time,
            derivative,
            filter,
            period,
            anti_windup,
            minimum_rack,
            maximum_rack,
            smoke_margin,
            turbocharger_lag,
            dead_time,
            lag,
            rack_rate,
            torque_rate,
            firing_interval,
            firing_width,
            blades,
            shaft_ripple,
            blade_ripple,
            blade_path,
            inflow,
            thrust,
            mass,
            resistance,
            initial_speed,
            initial_error,
            initial_ship_speed,
            set_point_before,
            crank_angle,
        ] = *numbers;
        let timing = if period == 0.0 {
            Timing::Continuous
        } else if period.is_finite() {
            Timing::Every(period)
        } else {
            Timing::AtFiring
        };
        Self {
            governor: Governor {
                base_rack,
                proportional,
                integral,
                derivative,
                filter,
                minimum_rack,
                maximum_rack,
                anti_windup: anti_windup > 0.5,
                timing,
            },
            set_dead_time,
            actuator: Actuator { dead_time, lag, rate: rack_rate },
            engine: Engine { rack_gain, speed_gain, offset, minimum_torque },
            smoke_margin,
            turbocharger_lag,
            torque_rate,
            firing_interval,
            firing_width,
            strength: tables.strength,
            gearbox: Gearbox { ratio, efficiency },
            drag,
            drag_exponent,
            shaft: Shaft { engine_side: inertia - propeller_side, propeller_side, stiffness, damping },
            propeller: Propeller {
                coefficient,
                exponent,
                thrust,
                blade_path,
                inflow,
                blades,
                shaft_ripple,
                blade_ripple,
                quadrants: tables.quadrants,
            },
            ship: Ship { mass, resistance },
            initial_speed,
            initial_error,
            initial_ship_speed,
            set_point_before,
            crank_angle,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_vector_of_odd_numbers_panics() {
        for odd in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -1.0] {
            for place in 0..PARAMETERS.len() {
                let mut values = [1.0; PARAMETERS.len()];
                values[0] = 2.0;
                values[place] = odd;
                let _ = DriveTrain::from_parameters(&values, Tables::default());
            }
        }
    }
}
