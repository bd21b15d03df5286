//! Torque of single firings: each takes the fuel of its own moment and gives it back over its stroke.

use std::f64::consts::TAU;

/// Angles closer than this are one [rev]: 50 ns at 20 rev/s.
const SAME_ANGLE: f64 = 1e-6;

/// Firings in turn, equally spaced.
#[derive(Debug, Clone)]
pub struct Firing {
    /// Angle between firings [rev of the engine], zero for a torque without pulses.
    interval: f64,
    /// Angle over which a firing works [rev of the engine].
    width: f64,
    /// Each cylinder's torque over the mean of all, in the order of firing.
    strength: Vec<f64>,
    /// Torque for which each cylinder was last fuelled [Nm].
    fuelled: Vec<f64>,
    /// Number of the latest firing, the first one of the record being zero.
    count: i64,
}

impl Firing {
    /// Running steadily at a torque [Nm], a firing due at angle zero.
    #[must_use]
    pub fn new(interval: f64, width: f64, strength: &[f64], torque: f64) -> Self {
        let fuelled = strength.iter().map(|strength| torque * strength).collect();
        Self { interval, width, strength: strength.to_vec(), fuelled, count: -1 }
    }

    /// Whether single firings are told apart.
    #[inline(always)]
    #[must_use]
    pub fn acts(&self) -> bool {
        self.interval > 0.0
    }

    /// Whether the next firing is due at an angle of the crankshaft [rev].
    #[inline(always)]
    #[must_use]
    pub fn due(&self, crank: f64) -> bool {
        self.left(crank) <= SAME_ANGLE
    }

    /// Angle that is left to the next firing [rev], infinite where there is none.
    #[inline(always)]
    #[must_use]
    pub fn left(&self, crank: f64) -> f64 {
        if self.acts() { (self.count + 1) as f64 * self.interval - crank } else { f64::INFINITY }
    }

    /// Fire the next cylinder with the fuel for a mean torque [Nm].
    pub fn fire(&mut self, torque: f64) {
        self.count += 1;
        let cylinder = self.cylinder(self.count);
        self.fuelled[cylinder] = torque * self.strength[cylinder];
    }

    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_possible_wrap)]
    fn cylinder(&self, firing: i64) -> usize {
        firing.rem_euclid(self.strength.len() as i64) as usize
    }

    /// Torque at an angle of the crankshaft [rev]: a raised cosine over each working stroke, of mean one in their sum.
    #[must_use]
    pub fn torque(&self, crank: f64) -> f64 {
        let mut torque = 0.0;
        for back in 0..self.strength.len() {
            #[allow(clippy::cast_possible_wrap)]
            let firing = self.count - back as i64;
            let age = crank - firing as f64 * self.interval;
            if age >= self.width {
                break;
            }
            let share = self.interval / self.width * (1.0 - (TAU * age / self.width).cos());
            torque += share * self.fuelled[self.cylinder(firing)];
        }
        torque
    }
}

#[cfg(test)]
mod tests {
    use super::Firing;

    #[test]
    fn steady_firing_has_the_mean_torque_it_was_fuelled_for() {
        let mut firing = Firing::new(1.0 / 3.0, 0.5, &[1.1, 1.0, 0.9, 1.1, 1.0, 0.9], 200.0);
        let (mut sum, steps) = (0.0, 6000);
        for step in 0..steps {
            let crank = f64::from(step) * 2.0 / f64::from(steps);
            while firing.due(crank) {
                firing.fire(200.0);
            }
            sum += firing.torque(crank);
        }
        assert!((sum / f64::from(steps) - 200.0).abs() < 1e-3, "{}", sum / f64::from(steps));
    }
}
