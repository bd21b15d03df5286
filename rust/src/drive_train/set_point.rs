//! The set point behind the dead time of its path.

use crate::integrate::Hold;
use crate::scalar::Scalar;

/// Samples of the set point as the governor sees them.
#[derive(Debug, Clone, Copy)]
pub struct SetPoint<'a, T = f64> {
    /// Engine speed [rev/s].
    pub samples: &'a [f64],
    /// What it was before the first sample [rev/s].
    pub before: T,
    /// Time between samples [s].
    pub dt: f64,
    /// [s].
    pub dead_time: T,
    /// Between samples.
    pub hold: Hold,
}

impl<T: Scalar> SetPoint<'_, T> {
    /// The value at a time on the piece that holds the time `within`.
    #[inline(always)]
    #[must_use]
    pub fn at(&self, time: T, within: f64) -> T {
        let place = ((within - self.dead_time.value()) / self.dt).floor();
        if place < 0.0 {
            return self.before;
        }
        let last = self.samples.len() - 1;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // Not negative; saturates.
        let piece = (place as usize).min(last);
        let from = self.samples[piece];
        match self.hold {
            Hold::First if piece < last => {
                let slope = (self.samples[piece + 1] - from) / self.dt;
                (time - self.dead_time + piece as f64 * -self.dt) * slope + from
            }
            Hold::Zero | Hold::First => time.constant(from),
        }
    }

    /// The next time after one at which a sample arrives.
    #[inline(always)]
    #[must_use]
    pub fn next_break(&self, after: f64) -> T {
        if self.dead_time.value() > 0.0 || !self.dead_time.is_constant() {
            let passed = ((after - self.dead_time.value()) / self.dt).floor().max(-1.0);
            self.dead_time + (passed + 1.0) * self.dt
        } else {
            self.dead_time.constant(f64::INFINITY)
        }
    }
}
