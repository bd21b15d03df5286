//! Torque of single firings: each takes its fuel at one moment and turns it into torque over its stroke.

use super::cosine::cosine;

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
    /// Number of the latest firing, the first one of the record being zero, and its cylinder.
    count: f64,
    latest: usize,
}

impl Firing {
    /// Running steadily at a torque [Nm], a firing due at angle zero.
    #[must_use]
    pub fn new(interval: f64, width: f64, strength: &[f64], torque: f64) -> Self {
        let fuelled = strength.iter().map(|&strength| torque * strength).collect();
        let latest = strength.len().saturating_sub(1);
        Self { interval, width, strength: strength.to_vec(), fuelled, count: -1.0, latest }
    }

    /// Whether single firings are simulated.
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
        if self.acts() { (self.count + 1.0) * self.interval - crank } else { f64::INFINITY }
    }

    /// Fire the next cylinder with the fuel for a mean torque [Nm].
    #[inline(always)]
    pub fn fire(&mut self, torque: f64) {
        self.count += 1.0;
        self.latest = if self.latest + 1 < self.strength.len() { self.latest + 1 } else { 0 };
        self.fuelled[self.latest] = torque * self.strength[self.latest];
    }

    /// Torque at an angle of the crankshaft [rev]: a raised cosine over each working stroke, of mean one in their sum.
    #[inline(always)]
    #[must_use]
    pub fn torque(&self, crank: f64) -> f64 {
        let mut torque = 0.0;
        let (mut firing, mut cylinder, per_width) = (self.count, self.latest, 1.0 / self.width);
        for _ in 0..self.fuelled.len() {
            let age = crank + firing * -self.interval;
            if age >= self.width {
                break;
            }
            torque += (1.0 - cosine(age * per_width)) * self.fuelled[cylinder];
            firing -= 1.0;
            cylinder = if cylinder == 0 { self.fuelled.len() } else { cylinder } - 1;
        }
        torque * (self.interval * per_width)
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
