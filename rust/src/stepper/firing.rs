//! Torque of single firings: the fuel is set at one moment and becomes torque over the stroke, as a raised cosine.

use std::f64::consts::TAU;

use crate::error::{Result, require};

/// Equally spaced firings.
#[derive(Debug, Clone)]
pub struct Firing {
    /// Angle between two firings, and angle of a stroke [rev of the engine].
    interval: f64,
    width: f64,
    engine_hz: f64,
    /// Torque of each cylinder over the mean, in firing order.
    strength: Vec<f64>,
    /// Crankshaft angle, and its change in the last step [rev].
    crank: f64,
    turned: f64,
    /// Number of the latest firing, zero at the first sample, and its cylinder.
    count: f64,
    latest: usize,
    /// For each cylinder, the mean torque of its last fuel times its strength, and the share of this fuel that is burnt.
    fuelled: Vec<f64>,
    spent: Vec<f64>,
    /// Torque at the step's end, and its mean over the step.
    torque: f64,
    mean: f64,
    /// Fraction of the step after which a cylinder fires.
    pub due: Option<f64>,
}

impl Firing {
    /// Steady state with a firing due at angle zero; None without an interval.
    ///
    /// # Errors
    /// [`Error::Invalid`](crate::error::Error::Invalid) if a stroke is longer than a cycle, or a strength is not finite.
    pub fn new([interval, width, engine_hz]: [f64; 3], strength: &[f64]) -> Result<Option<Self>> {
        let cycle = interval * strength.len() as f64;
        require(interval == 0.0 || width > 0.0 && width <= cycle, || {
            format!("detail: found width = {width}, expected more than 0 and at most a cycle, {cycle}")
        })?;
        require(strength.iter().all(|strength| strength.is_finite()), || {
            format!("strength is {strength:?}, expected finite numbers")
        })?;
        let mut firing = Self {
            interval,
            width,
            engine_hz,
            strength: strength.to_vec(),
            crank: 0.0,
            turned: 1.0,
            count: -1.0,
            latest: strength.len().saturating_sub(1),
            fuelled: strength.to_vec(),
            spent: vec![0.0; strength.len()],
            torque: 0.0,
            mean: 0.0,
            due: None,
        };
        if interval > 0.0 {
            firing.burn();
        }
        Ok((interval > 0.0).then_some(firing))
    }

    /// Torque at the step's end, and its mean over the step.
    #[inline(always)]
    pub const fn torques(&self) -> [f64; 2] {
        [self.torque, self.mean]
    }

    /// Turn the crankshaft over a step `h` [s] at a mean speed, and determine whether a cylinder fires.
    #[inline(always)]
    pub fn turn(&mut self, speed: f64, h: f64) {
        self.turned = h * self.engine_hz * speed;
        let left = (self.count + 1.0) * self.interval - self.crank;
        self.due = (left <= self.turned).then(|| (left / self.turned).clamp(0.0, 1.0 - 1e-8));
        self.crank += self.turned;
        self.burn();
    }

    /// Fire the cylinders that are due, with the fuel for this mean torque.
    #[inline(always)]
    pub fn fire(&mut self, torque: f64) {
        for _ in 0..self.strength.len() {
            let age = (self.crank - (self.count + 1.0) * self.interval) / self.width;
            if age < 0.0 {
                break;
            }
            self.count += 1.0;
            self.latest = if self.latest + 1 < self.strength.len() { self.latest + 1 } else { 0 };
            (self.fuelled[self.latest], self.spent[self.latest]) = (torque * self.strength[self.latest], 0.0);
            self.burn_until(age, self.latest);
        }
    }

    /// Continue the strokes of cylinders that have fired.
    #[inline(always)]
    fn burn(&mut self) {
        (self.torque, self.mean) = (0.0, 0.0);
        let mut cylinder = self.latest;
        let mut age = (self.crank - self.count * self.interval) / self.width;
        for _ in 0..self.strength.len() {
            if self.spent[cylinder] == 1.0 {
                break;
            }
            self.burn_until(age, cylinder);
            age += self.interval / self.width;
            cylinder = if cylinder == 0 { self.strength.len() } else { cylinder } - 1;
        }
    }

    /// Continue a cylinder's stroke until `age`, the time since its firing in strokes.
    #[inline(always)]
    fn burn_until(&mut self, age: f64, cylinder: usize) {
        let (before, fuel) = (self.spent[cylinder], self.fuelled[cylinder] * self.interval);
        let mut spent = 1.0;
        if age < 1.0 {
            let (sine, cosine) = (TAU * age).sin_cos();
            self.torque += (1.0 - cosine) * fuel / self.width;
            spent = age - sine / TAU;
        }
        self.spent[cylinder] = spent;
        self.mean += (spent - before) * fuel / self.turned;
    }
}

#[cfg(test)]
mod tests {
    use super::Firing;

    #[test]
    fn steady_firing_has_the_mean_torque_it_was_fuelled_for() {
        let strength = [1.1, 1.0, 0.9, 1.1, 1.0, 0.9];
        let mut firing = Firing::new([1.0 / 3.0, 0.5, 1.0], &strength).unwrap().unwrap();
        let steps = 600;
        for cycle in 0..2 {
            let mut sums = [0.0; 2];
            for _ in 0..steps {
                firing.turn(1.0, 2.0 / f64::from(steps));
                firing.fire(1.0);
                sums = std::array::from_fn(|k| sums[k] + firing.torques()[k]);
            }
            for sum in sums {
                assert!((sum / f64::from(steps) - 1.0).abs() < 1e-6, "{cycle} {sum}");
            }
        }
    }
}
