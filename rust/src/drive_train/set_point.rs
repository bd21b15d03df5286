//! The set point behind the dead time of its path.

use crate::hold::Hold;

/// Samples of the set point as the governor sees them.
#[derive(Debug, Clone, Copy)]
pub struct SetPoint<'a> {
    /// Engine speed [rev/s].
    pub samples: &'a [f64],
    /// What it was before the first sample [rev/s].
    pub before: f64,
    /// Time between samples [s].
    pub dt: f64,
    /// [s].
    pub dead_time: f64,
    /// Between samples.
    pub hold: Hold,
}

impl SetPoint<'_> {
    /// The value at a time on the piece that holds the time `within`.
    #[inline(always)]
    #[must_use]
    pub fn at(&self, time: f64, within: f64) -> f64 {
        let place = ((within - self.dead_time) / self.dt).floor();
        if place < 0.0 {
            return self.before;
        }
        let last = self.samples.len() - 1;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        // Not negative; saturates.
        let piece = (place as usize).min(last);
        let from = self.samples[piece];
        match self.hold {
            Hold::First if piece < last => {
                let slope = (self.samples[piece + 1] - from) / self.dt;
                (time - self.dead_time + piece as f64 * -self.dt) * slope + from
            }
            Hold::Zero | Hold::First => from,
        }
    }

    /// The next time after one at which a sample arrives.
    #[inline(always)]
    #[must_use]
    pub fn next_break(&self, after: f64) -> f64 {
        if self.dead_time > 0.0 {
            let passed = ((after - self.dead_time) / self.dt).floor().max(-1.0);
            self.dead_time + (passed + 1.0) * self.dt
        } else {
            f64::INFINITY
        }
    }
}
