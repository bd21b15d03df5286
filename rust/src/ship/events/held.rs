//! An input between its samples.

use crate::integrate::Hold;
use crate::scalar::Scalar;

/// A sampled input.
#[derive(Debug, Clone, Copy)]
pub struct Held<'a> {
    samples: &'a [f64],
    dt: f64,
    hold: Hold,
}

/// A straight piece of an input: its value at its origin [s] and its slope.
#[derive(Debug, Clone, Copy)]
pub struct Piece {
    pub from: f64,
    pub slope: f64,
    pub origin: f64,
}

impl Piece {
    /// Nothing.
    pub const ZERO: Self = Self { from: 0.0, slope: 0.0, origin: 0.0 };

    /// The value at a time.
    #[inline(always)]
    pub fn at<T: Scalar>(&self, time: T) -> T {
        if self.slope == 0.0 {
            return time.constant(self.from);
        }
        (time + -self.origin) * self.slope + self.from
    }
}

/// Times closer than this share of a sample time are one.
const SAME: f64 = 1e-9;

impl<'a> Held<'a> {
    pub const fn new(samples: &'a [f64], dt: f64, hold: Hold) -> Self {
        Self { samples, dt, hold }
    }

    /// The first sample, 0 where there is none.
    pub fn first(&self) -> f64 {
        self.samples.first().copied().unwrap_or(0.0)
    }

    /// The piece that begins at a time or holds it; the ends of the record hold.
    #[inline(always)]
    pub fn piece(&self, time: f64) -> Piece {
        let place = (time / self.dt + SAME).floor();
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // Saturates.
        self.piece_after(if place < 0.0 { 0 } else { (place as usize).saturating_add(1) })
    }

    /// The piece that begins with the last of so many samples.
    #[inline(always)]
    pub fn piece_after(&self, passed: usize) -> Piece {
        let Some(last) = self.samples.len().checked_sub(1) else { return Piece::ZERO };
        let Some(index) = passed.checked_sub(1) else {
            return Piece { from: self.samples[0], ..Piece::ZERO };
        };
        let index = index.min(last);
        let from = self.samples[index];
        let slope = match self.hold {
            Hold::First if index < last => (self.samples[index + 1] - from) / self.dt,
            Hold::Zero | Hold::First => 0.0,
        };
        Piece { from, slope, origin: index as f64 * self.dt }
    }

    /// Whether it jumps at its samples.
    pub fn jumps(&self) -> bool {
        self.hold == Hold::Zero
    }
}
