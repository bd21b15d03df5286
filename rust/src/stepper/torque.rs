//! Torque of the engine, within its limits.

use super::step::Ship;

impl<const D: bool> Ship<'_, D> {
    #[inline(always)]
    pub(super) fn fuel(&self, rack: f64) -> f64 {
        if self.acting.gain { self.c.v * rack } else { rack }
    }

    /// Engine torque at a speed and a rack position, and which torque limit is active.
    #[inline(always)]
    pub(super) fn engine(&self, speed: f64, rack: f64) -> (f64, i8) {
        let apart = speed - 1.0;
        self.within_torque(self.fuel(rack) + self.c.g * apart + 1.0, apart)
    }

    #[inline(always)]
    pub(super) fn within_torque(&self, torque: f64, apart: f64) -> (f64, i8) {
        if self.acting.torque_limit {
            let highest = self.highest(apart);
            if self.c.softness > 0.0 {
                return softly_within(torque, highest, self.c.softness);
            }
            if torque > highest {
                return (highest, 1);
            }
            if torque < self.c.lowest {
                return (self.c.lowest, -1);
            }
        }
        (torque, 0)
    }

    #[inline(always)]
    fn highest(&self, apart: f64) -> f64 {
        match self.envelope {
            Some(envelope) => envelope.at(apart + 1.0),
            None => self.c.highest + self.c.highest_slope * apart,
        }
    }
}

/// Mean torque near a limit that noise sometimes exceeds: highest - softness ln(1 + exp z) with z = (highest - torque)
/// / softness.
#[inline(always)]
pub fn softly_within(torque: f64, highest: f64, softness: f64) -> (f64, i8) {
    /// Distance from a limit, in units of its softness, beyond which the limit has no effect.
    const FAR: f64 = 40.0;
    let z = (highest - torque) / softness;
    if z > FAR {
        return (torque, 0);
    }
    let grown = z.exp();
    let free = grown / (1.0 + grown);
    let apart = softness * (z * free - grown.ln_1p());
    (torque * free + highest * (1.0 - free) + apart, 1)
}
