//! Propeller behind a ship that may move: torque and thrust in four quadrants, and the ripple of the blades.

use crate::error::{Error, Result, require};
use crate::power::power;

use super::cosine::cosine;

/// Torque and thrust of a fixed-pitch propeller.
#[derive(Debug, Clone)]
pub struct Propeller {
    /// Torque in bollard pull [Nm/(rev/s)^exponent].
    pub coefficient: f64,
    /// Of the torque.
    pub exponent: f64,
    /// Thrust in bollard pull, less thrust deduction, of all propellers [N/(rev/s)^2].
    pub thrust: f64,
    /// Blade speed at 0.7 of the radius over the shaft speed, 0.7 pi D [m].
    pub blade_path: f64,
    /// Speed of the inflow over that of the ship, less than 1 in its wake.
    pub inflow: f64,
    /// Of the ripple.
    pub blades: f64,
    /// Amplitude of the torque at once a turn, over the mean.
    pub shaft_ripple: f64,
    /// Amplitude of the torque at blade passage, over the mean.
    pub blade_ripple: f64,
    /// None: bollard pull at any ship speed.
    pub quadrants: Option<Quadrants>,
}

/// Four-quadrant coefficients over the angle of the flow at the blades, each over its value in bollard pull.
#[derive(Debug, Clone)]
pub struct Quadrants {
    angle: Vec<f64>,
    torque: Vec<f64>,
    thrust: Vec<f64>,
}

impl Quadrants {
    /// From points that span a whole turn from -pi to pi [rad]; none for no table.
    ///
    /// # Errors
    /// Where the points differ in number, are not finite, don't ascend, or span less.
    pub fn new(angle: &[f64], torque: &[f64], thrust: &[f64]) -> Result<Option<Self>> {
        let points = angle.len();
        require(torque.len() == points && thrust.len() == points, || {
            format!("quadrants has {points} angles, {} torques, {} thrusts", torque.len(), thrust.len())
        })?;
        let (Some(&first), Some(&last)) = (angle.first(), angle.last()) else { return Ok(None) };
        let finite = [angle, torque, thrust].iter().all(|row| row.iter().all(|value| value.is_finite()));
        let ascending = angle.windows(2).all(|pair| pair[0] < pair[1]);
        let pi = std::f64::consts::PI;
        if !(finite && ascending && points > 1 && first <= -pi && last >= pi) {
            return Err(Error::Invalid(format!(
                "quadrants has {points} points from {first} to {last} rad, expected finite ones that ascend from -pi to pi"
            )));
        }
        Ok(Some(Self { angle: angle.to_vec(), torque: torque.to_vec(), thrust: thrust.to_vec() }))
    }

    /// Torque and thrust at an angle [rad], straight between points.
    #[inline(always)]
    #[must_use]
    fn at(&self, angle: f64) -> [f64; 2] {
        let to = self.angle.partition_point(|&point| point <= angle).clamp(1, self.angle.len() - 1);
        let part = (angle - self.angle[to - 1]) / (self.angle[to] - self.angle[to - 1]);
        let (torque, thrust) = (&self.torque[to - 1..=to], &self.thrust[to - 1..=to]);
        [torque[0] + part * (torque[1] - torque[0]), thrust[0] + part * (thrust[1] - thrust[0])]
    }
}

impl Propeller {
    /// Torque [Nm] and thrust [N] at a shaft speed [rev/s], an angle of the shaft [rev] and a ship speed [m/s].
    #[inline(always)]
    #[must_use]
    pub fn torque_and_thrust(&self, speed: f64, turn: f64, ship_speed: f64) -> [f64; 2] {
        let [mean, thrust] = self.mean_torque_and_thrust(speed, ship_speed);
        if self.shaft_ripple == 0.0 && self.blade_ripple == 0.0 {
            return [mean, thrust];
        }
        let ripple = self.shaft_ripple * cosine(turn) + self.blade_ripple * cosine(turn * self.blades);
        [mean * (ripple + 1.0), thrust]
    }

    /// The same without the ripple of the blades.
    #[inline(always)]
    #[must_use]
    pub fn mean_torque_and_thrust(&self, speed: f64, ship_speed: f64) -> [f64; 2] {
        match &self.quadrants {
            None => [self.coefficient * power(speed, self.exponent), self.thrust * speed * speed.abs()],
            Some(quadrants) => {
                let along = self.blade_path * speed;
                let across = self.inflow * ship_speed;
                let flow = along.hypot(across) / self.blade_path;
                let [torque, thrust] = quadrants.at(across.atan2(along));
                [torque * self.coefficient * power(flow, self.exponent), thrust * self.thrust * flow * flow]
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::Quadrants;

    #[test]
    fn a_table_that_leaves_a_gap_is_refused() {
        assert!(matches!(Quadrants::new(&[], &[], &[]), Ok(None)));
        assert!(Quadrants::new(&[-PI, 3.0], &[1.0, 1.0], &[1.0, 1.0]).is_err());
        assert!(Quadrants::new(&[-PI, PI], &[1.0], &[1.0, 1.0]).is_err());
        assert!(Quadrants::new(&[-PI, PI], &[1.0, f64::NAN], &[1.0, 1.0]).is_err());
    }

    #[test]
    fn straight_between_points_and_no_panic_outside() {
        let table = Quadrants::new(&[-PI, 0.0, PI], &[-1.0, 1.0, -1.0], &[-2.0, 2.0, -2.0]).unwrap().unwrap();
        let [torque, thrust] = table.at(PI / 4.0);
        assert!((torque - 0.5).abs() < 1e-15 && (thrust - 1.0).abs() < 1e-15);
        assert!(table.at(f64::NAN)[0].is_nan());
    }
}
