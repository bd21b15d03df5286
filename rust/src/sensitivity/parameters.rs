//! The drive train whose outputs are differentiated, and the directions of its parameters in which they are.

use pulp::Simd;

use crate::drive_train::{DriveTrain, PARAMETERS, Tables};
use crate::error::{Error, Result, require};
use crate::plant::Envelope;
use crate::scalar::{Dual, Tangent};

const WIDTH: usize = PARAMETERS.len();

/// Parameters of the elements that the short cut with two states lacks, with the values at which they do not act.
const OFF: [(&str, f64); 15] = [
    ("shaft_stiffness", f64::INFINITY),
    ("drag_coefficient", 0.0),
    ("Kd_abs", 0.0),
    ("governor_period", 0.0),
    ("anti_windup", 0.0),
    ("minimum_rack", f64::NEG_INFINITY),
    ("maximum_rack", f64::INFINITY),
    ("smoke_margin", f64::INFINITY),
    ("fuel_dead_time", 0.0),
    ("fuel_lag", 0.0),
    ("firing_interval", 0.0),
    ("shaft_ripple", 0.0),
    ("blade_ripple", 0.0),
    ("ship_mass", f64::INFINITY),
    ("set_point_before", f64::NAN),
];

/// Parameters by which nothing is differentiated: counts, switches, and what divides the time or the turn.
const HELD: [&str; 5] = ["governor_period", "anti_windup", "firing_interval", "firing_width", "blades"];
/// Parameters of which zero means that there is no such element.
const ABSENT_AT_ZERO: [&str; 2] = ["fuel_dead_time", "fuel_lag"];

/// Directions that one pass can differentiate in: more than there are parameters tell nothing more.
pub const MOST: usize = 24;

/// A drive train and the directions of its parameters in which it is differentiated.
#[derive(Debug, Clone)]
pub struct Subject {
    values: [f64; WIDTH],
    /// One row of [`PARAMETERS`] a direction.
    directions: Vec<f64>,
    tables: Tables,
    pub(super) envelope: Envelope,
}

impl Subject {
    /// From a vector in the order of [`PARAMETERS`] and rows of its directions.
    ///
    /// # Errors
    /// Where a length is wrong or a value makes no sense; the message names it.
    pub fn new(values: &[f64], directions: &[f64], envelope: Envelope, tables: Tables) -> Result<Self> {
        DriveTrain::of_any_inertias(values, tables.clone())?;
        let values = <[f64; WIDTH]>::try_from(values)
            .map_err(|_| Error::Internal("the parameter vector changed its length".to_owned()))?;
        require(directions.len().is_multiple_of(WIDTH) && directions.len() <= MOST * WIDTH, || {
            format!("directions has {} values, expected up to {MOST} rows of {WIDTH}", directions.len())
        })?;
        for (place, slope) in directions.iter().enumerate() {
            let (row, name) = (place / WIDTH, PARAMETERS[place % WIDTH]);
            require(slope.is_finite(), || {
                format!("directions[{row}]: {name} is {slope}, expected a finite number")
            })?;
            let value = values[place % WIDTH];
            let absent = !value.is_finite() || (value == 0.0 && ABSENT_AT_ZERO.contains(&name));
            require(*slope == 0.0 || !(absent || HELD.contains(&name)), || {
                let why =
                    if absent { format!("where the parameter is {value}") } else { "always".to_owned() };
                format!("directions[{row}]: {name} is {slope}, expected 0 {why}")
            })?;
        }
        Ok(Self { values, directions: directions.to_vec(), tables, envelope })
    }

    /// Number of directions.
    #[must_use]
    pub fn directions(&self) -> usize {
        self.directions.len() / WIDTH
    }

    /// Whether a parameter has this value in all directions.
    fn is_constant(&self, name: &str, value: f64) -> bool {
        let place = place(name);
        let same = value.is_nan() || self.values[place].total_cmp(&value).is_eq();
        let mut slopes = self.directions.iter().skip(place).step_by(WIDTH);
        same && slopes.all(|slope| *slope == 0.0)
    }

    /// Whether nothing acts but ramps and a dead time of the set point.
    #[must_use]
    pub fn is_plant(&self) -> bool {
        self.tables.quadrants.is_none() && OFF.iter().all(|(name, value)| self.is_constant(name, *value))
    }

    /// The drive train it is.
    ///
    /// # Errors
    /// None: the values are checked.
    pub(super) fn whole(&self) -> Result<DriveTrain> {
        DriveTrain::of_any_inertias(&self.values, self.tables.clone())
    }

    /// The whole drive train in numbers with room for `N` directions.
    pub(super) fn drive_train<S: Simd, const N: usize>(&self, simd: S) -> DriveTrain<Dual<S, N>> {
        let mut numbers = self.values.map(|value| Tangent { value, slopes: [0.0; N] });
        for (row, slopes) in self.directions.chunks_exact(WIDTH).enumerate() {
            for (number, slope) in numbers.iter_mut().zip(slopes) {
                number.slopes[row] = *slope;
            }
        }
        DriveTrain::of(numbers.map(|number| Dual::new(simd, number)), self.tables.clone())
    }
}

fn place(name: &str) -> usize {
    PARAMETERS.iter().position(|&other| other == name).unwrap_or(WIDTH)
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
                let _ =
                    Subject::new(&values, &direction, Envelope::new(&[], &[]).unwrap(), Tables::default());
                let _ =
                    Subject::new(&[1.0; WIDTH], &values, Envelope::new(&[], &[]).unwrap(), Tables::default());
            }
        }
    }

    #[test]
    fn more_directions_than_there_is_room_for_are_refused() {
        let subject = |rows: usize| {
            let mut values = [1.0; WIDTH];
            (values[place("maximum_rack")], values[place("firing_interval")]) = (2.0, 0.0);
            let directions = vec![0.0; rows * WIDTH];
            Subject::new(&values, &directions, Envelope::new(&[], &[]).unwrap(), Tables::default())
        };
        assert!(subject(MOST).is_ok());
        assert!(subject(MOST + 1).is_err());
    }
}
