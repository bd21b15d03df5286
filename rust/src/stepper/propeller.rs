//! Propeller of a ship at bollard pull or under way: torque and thrust in four quadrants, and the ripple of the blades.

use std::f64::consts::TAU;

use super::envelope::Envelope;
use super::law::Law;

/// Torque and thrust over bollard pull, by flow angle [rad].
pub type Quadrants = [Envelope; 2];

/// The propeller and its ship.
#[derive(Debug, Clone)]
pub struct Propeller {
    bollard: f64,
    shaft_hz: f64,
    blades: f64,
    shaft_ripple: f64,
    blade_ripple: f64,
    push: f64,
    resistance: f64,
    quadrants: Option<Quadrants>,
    /// Angle [rev], water speed, and rate of the latter.
    turn: f64,
    water: f64,
    pub pace: f64,
}

impl Propeller {
    /// From the last parameters in the order of [`DETAIL`](super::DETAIL).
    pub fn new(numbers: [f64; 8], quadrants: Option<Quadrants>) -> Self {
        let [bollard, shaft_hz, blades, shaft_ripple, blade_ripple, water, push, resistance] = numbers;
        let mut propeller = Self {
            bollard,
            shaft_hz,
            blades,
            shaft_ripple,
            blade_ripple,
            push,
            resistance,
            quadrants,
            turn: 0.0,
            water,
            pace: 0.0,
        };
        propeller.pace = propeller.pace_at(1.0, water);
        propeller
    }

    /// Load at a speed, and its slope; means over a revolution.
    #[inline(always)]
    pub fn mean_load(&self, law: &mut Law, speed: f64) -> [f64; 2] {
        let (mut flow, mut share) = (speed, self.bollard);
        if let Some([torque, _]) = &self.quadrants {
            share *= torque.at(self.water.atan2(flow));
            flow = flow.hypot(self.water);
        }
        law.at(flow).map(|found| found * share)
    }

    /// Torque over its mean, at the present angle.
    #[inline(always)]
    pub fn ripple(&self) -> f64 {
        let mut ripple = 1.0;
        for (amplitude, waves) in [(self.shaft_ripple, 1.0), (self.blade_ripple, self.blades)] {
            if amplitude != 0.0 {
                ripple += amplitude * (TAU * waves * self.turn).cos();
            }
        }
        ripple
    }

    /// Advance a step in which the propeller's speed changes; return the load at its end, and its slope.
    #[inline(always)]
    pub fn load(&mut self, law: &mut Law, from: f64, to: f64, h: f64) -> [f64; 2] {
        self.turn += h * self.shaft_hz * 0.5 * (from + to);
        let pace = self.pace_at(to, self.water + h * self.pace);
        self.water += 0.5 * h * (self.pace + pace);
        self.pace = pace;
        let ripple = self.ripple();
        self.mean_load(law, to).map(|value| value * ripple)
    }

    /// Rate of the ship's speed.
    #[inline(always)]
    fn pace_at(&self, speed: f64, water: f64) -> f64 {
        self.quadrants.as_ref().map_or(0.0, |[_, thrust]| {
            let thrust = thrust.at(water.atan2(speed)) * (speed * speed + water * water);
            self.push * thrust - self.resistance * water * water.abs()
        })
    }
}
