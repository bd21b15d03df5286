//! What the inputs feed into the governor and the shaft, piece by piece.

use crate::integrate::Hold;

use super::grid::{Piece, Time};

/// A held input behind a delay, and its integral.
pub struct Feed<'a> {
    samples: &'a [f64],
    hold: Hold,
    dt: f64,
    late: Time,
    /// The sample that rules, and the integral of the input less one from the record's start up to it [s].
    at: isize,
    sum: f64,
}

/// An input over a piece: its value and slope at the start, the latter a piece; and the integral up to the start [s].
#[derive(Debug, Clone, Copy, Default)]
pub struct Input {
    pub value: f64,
    pub slope: f64,
    pub integral: f64,
}

impl<'a> Feed<'a> {
    /// Late by so many sample intervals.
    pub fn new(samples: &'a [f64], hold: Hold, dt: f64, late: f64) -> Self {
        Self { samples, hold, dt, late: Time::new(late), at: 0, sum: 0.0 }
    }

    #[inline(always)]
    fn sample(&self, at: isize) -> f64 {
        self.samples[usize::try_from(at).unwrap_or(0).min(self.samples.len() - 1)]
    }

    /// The slope behind a sample, for a sample interval.
    #[inline(always)]
    fn slope(&self, at: isize) -> f64 {
        if self.hold == Hold::Zero || at < 0 { 0.0 } else { self.sample(at + 1) - self.sample(at) }
    }

    /// Over a piece; pieces come in order.
    #[inline(always)]
    pub fn over(&mut self, piece: &Piece) -> Input {
        // A break stands at the start of its piece but for rounding.
        let mut whole = piece.start.whole.saturating_sub(self.late.whole);
        let mut part = piece.start.part - self.late.part;
        if part < -1e-9 {
            (whole, part) = (whole - 1, part + 1.0);
        } else if part >= 1.0 - 1e-9 {
            (whole, part) = (whole + 1, part - 1.0);
        }
        let part = part.max(0.0);
        while self.at < whole {
            self.sum += self.dt * (self.sample(self.at) - 1.0 + 0.5 * self.slope(self.at));
            self.at += 1;
        }
        let (first, slope) = (self.sample(whole), self.slope(whole));
        let (sum, passed) = if whole < 0 { (0.0, whole as f64 + part) } else { (self.sum, part) };
        Input {
            value: first + slope * part,
            slope: slope * piece.length,
            integral: sum + self.dt * passed * (first - 1.0 + 0.5 * slope * passed),
        }
    }
}
