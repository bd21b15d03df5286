//! Torque of the engine, within its limits.

use crate::scalar::Scalar;

use super::step::Ship;

impl<T: Scalar, const D: bool> Ship<'_, T, D> {
    #[inline(always)]
    pub(super) fn fuel(&self, rack: T) -> T {
        if self.acting.gain { self.c.v * rack } else { rack }
    }

    /// Torque of the engine at a speed and a rack, and the side of a limit that holds it.
    #[inline(always)]
    pub(super) fn engine(&self, speed: T, rack: T) -> (T, i8) {
        let apart = speed + -1.0;
        self.within_torque(self.fuel(rack).plus_product(self.c.g, apart) + 1.0, apart)
    }

    #[inline(always)]
    pub(super) fn within_torque(&self, torque: T, apart: T) -> (T, i8) {
        if self.acting.torque_limit {
            let highest = self.highest(apart);
            if self.c.softness.value() > 0.0 {
                return self.softly_within(torque, highest);
            }
            if torque.value() > highest.value() {
                return (highest, 1);
            }
            if torque.value() < self.c.lowest.value() {
                return (self.c.lowest, -1);
            }
        }
        (torque, 0)
    }

    #[inline(always)]
    fn highest(&self, apart: T) -> T {
        match self.envelope {
            Some(envelope) => {
                let [torque, slope] = envelope.at(apart.value() + 1.0);
                apart.function(torque, slope)
            }
            None => self.c.highest.plus_product(self.c.highest_slope, apart),
        }
    }

    /// The mean torque below a limit that noise reaches now and then: highest - softness ln(1 + exp z) with
    /// z = (highest - torque) / softness.
    #[inline(always)]
    fn softly_within(&self, torque: T, highest: T) -> (T, i8) {
        /// From this distance on, in units of the softness, a limit does nothing.
        const FAR: f64 = 40.0;
        let z = (highest.value() - torque.value()) / self.c.softness.value();
        if z > FAR {
            return (torque, 0);
        }
        let grown = z.exp();
        let free = grown / (1.0 + grown);
        let apart = self.c.softness * (z * free - grown.ln_1p());
        (torque * free + highest * (1.0 - free) + apart, 1)
    }
}
