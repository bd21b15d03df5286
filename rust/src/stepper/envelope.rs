//! Torque-speed envelope of the engine (Fig. 3.3): highest torque, linear between points, constant outside.

use crate::error::{Error, Result, require};

/// Points in order of speed; none: no limit.
#[derive(Debug, Clone, PartialEq)]
pub struct Envelope {
    speed: Vec<f64>,
    torque: Vec<f64>,
    /// Slope after each point.
    slope: Vec<f64>,
}

impl Envelope {
    /// Validate the points.
    ///
    /// # Errors
    /// If the numbers of points differ, values are not finite, or speeds do not ascend.
    pub fn new(speed: &[f64], torque: &[f64]) -> Result<Self> {
        require(speed.len() == torque.len(), || {
            format!("limit_torque has {} values, expected {} as in limit_speed", torque.len(), speed.len())
        })?;
        for (name, values) in [("limit_speed", speed), ("limit_torque", torque)] {
            if let Some(bad) = values.iter().position(|value| !value.is_finite()) {
                let found = values[bad];
                return Err(Error::Invalid(format!("{name}[{bad}] is {found}, expected a finite number")));
            }
        }
        if let Some(bad) = (1..speed.len()).find(|&i| speed[i] <= speed[i - 1]) {
            let (found, before) = (speed[bad], speed[bad - 1]);
            return Err(Error::Invalid(format!(
                "limit_speed[{bad}] is {found} after {before}, expected ascending speeds"
            )));
        }
        let between = (1..speed.len()).map(|i| (torque[i] - torque[i - 1]) / (speed[i] - speed[i - 1]));
        let slope = between.chain([0.0]).collect();
        Ok(Self { speed: speed.to_vec(), torque: torque.to_vec(), slope })
    }

    /// Whether there is no limit at any speed.
    #[must_use]
    pub const fn is_unlimited(&self) -> bool {
        self.speed.is_empty()
    }

    /// Highest torque at a speed.
    #[inline(always)]
    #[must_use]
    pub fn at(&self, speed: f64) -> f64 {
        let above = self.speed.iter().position(|&point| speed < point).unwrap_or(self.speed.len());
        let Some(below) = above.checked_sub(1) else {
            return self.torque.first().copied().unwrap_or(f64::INFINITY);
        };
        let slope = self.slope[below];
        let run = if slope == 0.0 { 0.0 } else { speed - self.speed[below] };
        self.torque[below] + slope * run
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SPEED: [f64; 4] = [10.0, 15.0, 15.5, 30.0];
    const TORQUE: [f64; 4] = [100.0, 460.0, 440.0, 300.0];

    proptest! {
        #[test]
        fn every_lookup_is_the_interpolation(speed in -5.0..40.0) {
            let torque = Envelope::new(&SPEED, &TORQUE).unwrap().at(speed);
            let within = speed.clamp(SPEED[0], SPEED[3]);
            let i = (0..3).rev().find(|&i| within >= SPEED[i]).unwrap_or(0);
            let part = (within - SPEED[i]) / (SPEED[i + 1] - SPEED[i]);
            let expected = TORQUE[i] * (1.0 - part) + TORQUE[i + 1] * part;
            prop_assert!((torque - expected).abs() < 1e-12 * expected);
        }
    }

    #[test]
    #[allow(clippy::float_cmp)] // Exact on purpose.
    fn no_point_is_no_limit_one_is_a_constant_and_any_speed_is_survived() {
        assert_eq!(Envelope::new(&[], &[]).unwrap().at(20.0), f64::INFINITY);
        assert_eq!(Envelope::new(&[20.0], &[446.0]).unwrap().at(7.0), 446.0);
        let table = Envelope::new(&SPEED, &TORQUE).unwrap();
        for speed in [f64::INFINITY, f64::NEG_INFINITY, f64::NAN] {
            let _ = table.at(speed);
        }
    }
}
