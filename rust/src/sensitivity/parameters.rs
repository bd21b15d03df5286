//! Parameter vector of the plant with its elements, and the directions in which it is differentiated.

use crate::drive_train::{Ramp, Shaft};
use crate::error::{Error, Result, require};
use crate::plant::{self, Engine, Envelope, Gearbox, Governor, Plant, Propeller};
use crate::scalar::{Dual, Scalar, Tangent};
use pulp::Simd;

const OWN: [&str; 7] = [
    "propeller_inertia",
    "limit_factor",
    "rack_rate",
    "torque_rate",
    "set_dead_time",
    "initial_speed",
    "initial_error",
];
const WIDTH: usize = plant::PARAMETERS.len() + OWN.len();

/// Names of the entries of a parameter vector, in order: those of the plant first.
pub const PARAMETERS: [&str; WIDTH] = {
    let mut names = [""; WIDTH];
    let mut i = 0;
    while i < WIDTH {
        names[i] =
            if i < plant::PARAMETERS.len() { plant::PARAMETERS[i] } else { OWN[i - plant::PARAMETERS.len()] };
        i += 1;
    }
    names
};

/// Directions that one pass can differentiate in: more than there are parameters tell nothing more.
pub const MOST: usize = 24;

/// A plant and the directions of its parameters in which it is differentiated.
#[derive(Debug, Clone)]
pub struct Subject {
    values: [f64; WIDTH],
    /// One row of [`PARAMETERS`] a direction.
    directions: Vec<f64>,
    pub(super) envelope: Envelope,
}

/// The components, of numbers of one kind.
#[derive(Debug, Clone)]
pub struct Train<T> {
    pub governor: Governor<T>,
    pub engine: Engine<T>,
    pub gearbox: Gearbox<T>,
    pub propeller: Propeller<T>,
    pub shaft: Shaft<T>,
    /// On the torque envelope.
    pub limit_factor: T,
    /// Of the rack [mm/s].
    pub rack_rate: T,
    /// Of the brake torque [Nm/s].
    pub torque_rate: T,
    /// Of the set point's path [s].
    pub set_dead_time: T,
    /// Whether the propeller's exponent is 2 in all directions.
    pub square: bool,
    /// Whether there is a dead time, or a derivative by it.
    pub delays: bool,
    /// Of the shaft [rev/s].
    pub initial_speed: T,
    /// Integrated error [rev].
    pub initial_error: T,
}

impl Subject {
    /// From a vector in the order of [`PARAMETERS`] and rows of its directions.
    ///
    /// # Errors
    /// Where a length is wrong or a value makes no sense; the message names it.
    pub fn new(values: &[f64], directions: &[f64], envelope: Envelope) -> Result<Self> {
        let Ok(values) = <[f64; WIDTH]>::try_from(values) else {
            return Err(Error::Invalid(format!("parameters has {} values, expected {WIDTH}", values.len())));
        };
        let (shared, own) = values.split_at(plant::PARAMETERS.len());
        Plant::from_parameters(shared, "parameters")?;
        for (name, &value) in OWN.iter().zip(own) {
            let (fits, expected) = match *name {
                "rack_rate" | "torque_rate" => (value > 0.0, "a positive number, infinity for none"),
                "limit_factor" => (value > 0.0 && value.is_finite(), "a positive number"),
                "set_dead_time" | "propeller_inertia" => (value >= 0.0 && value.is_finite(), "zero or more"),
                _ => (value.is_finite(), "a finite number"),
            };
            require(fits, || format!("parameters: {name} is {value}, expected {expected}"))?;
        }
        require(directions.len().is_multiple_of(WIDTH) && directions.len() <= MOST * WIDTH, || {
            format!("directions has {} values, expected up to {MOST} rows of {WIDTH}", directions.len())
        })?;
        for (place, slope) in directions.iter().enumerate() {
            let (row, name) = (place / WIDTH, PARAMETERS[place % WIDTH]);
            require(slope.is_finite(), || {
                format!("directions[{row}]: {name} is {slope}, expected a finite number")
            })?;
            let value = values[place % WIDTH];
            require(*slope == 0.0 || value.is_finite(), || {
                format!("directions[{row}]: {name} is {slope}, expected 0 where the parameter is {value}")
            })?;
        }
        Ok(Self { values, directions: directions.to_vec(), envelope })
    }

    /// Number of directions.
    #[must_use]
    pub fn directions(&self) -> usize {
        self.directions.len() / WIDTH
    }

    /// Whether a parameter has this value in all directions.
    fn is_constant(&self, name: &str, value: f64) -> bool {
        let place = PARAMETERS.iter().position(|&other| other == name).unwrap_or(WIDTH);
        let mut all = self.values.iter().skip(place).take(1).map(|found| found - value);
        let mut slopes = self.directions.iter().skip(place).step_by(WIDTH).copied();
        all.all(|difference| difference == 0.0) && slopes.all(|slope| slope == 0.0)
    }

    /// The plant in numbers with room for `N` directions.
    pub(super) fn train<S: Simd, const N: usize>(&self, simd: S) -> Train<Dual<S, N>> {
        let mut numbers = self.values.map(|value| Tangent { value, slopes: [0.0; N] });
        for (row, slopes) in self.directions.chunks_exact(WIDTH).enumerate() {
            for (number, slope) in numbers.iter_mut().zip(slopes) {
                number.slopes[row] = *slope;
            }
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
            propeller_side,
            limit_factor,
            rack_rate,
            torque_rate,
            set_dead_time,
            initial_speed,
            initial_error,
        ] = numbers.map(|number| Dual::new(simd, number));
        Train {
            governor: Governor { base_rack, proportional, integral },
            engine: Engine { rack_gain, speed_gain, offset, minimum_torque },
            gearbox: Gearbox { ratio, efficiency },
            propeller: Propeller { coefficient, exponent },
            shaft: Shaft {
                engine_side: inertia - propeller_side,
                propeller_side,
                stiffness: inertia.constant(f64::INFINITY),
                damping: inertia.constant(0.0),
            },
            limit_factor,
            rack_rate,
            torque_rate,
            set_dead_time,
            square: self.is_constant("torque_exponent", 2.0),
            delays: !self.is_constant("set_dead_time", 0.0),
            initial_speed,
            initial_error,
        }
    }
}

impl<T: Scalar> Train<T> {
    /// Ramps at rest at a rack position [mm] and a brake torque [Nm].
    pub fn ramps(&self, rack: T, torque: T) -> [Ramp<T>; 2] {
        [Ramp::new(self.rack_rate, rack), Ramp::new(self.torque_rate, torque)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_vector_of_odd_numbers_panics() {
        for odd in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -1.0] {
            for place in 0..WIDTH {
                let (mut values, mut direction) = ([1.0; WIDTH], [0.0; WIDTH]);
                values[place] = odd;
                direction[place] = 1.0;
                let _ = Subject::new(&values, &direction, Envelope::new(&[], &[]).unwrap());
                let _ = Subject::new(&[1.0; WIDTH], &values, Envelope::new(&[], &[]).unwrap());
            }
        }
    }

    #[test]
    fn more_directions_than_there_is_room_for_are_refused() {
        let envelope = || Envelope::new(&[], &[]).unwrap();
        assert!(Subject::new(&[1.0; WIDTH], &[0.5; MOST * WIDTH], envelope()).is_ok());
        assert!(Subject::new(&[1.0; WIDTH], &[0.5; (MOST + 1) * WIDTH], envelope()).is_err());
    }
}
