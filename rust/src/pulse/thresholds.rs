//! Thresholds of the detector of pulses, and the crossings that it finds.

use crate::error::{Result, require};

/// An upward crossing of the middle: when, and by how much the signal rose between the two samples beside it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge {
    /// In samples since the very first.
    pub time: f64,
    /// Infinite next to a saturated sample.
    pub rise: f64,
}

impl Edge {
    pub(super) const NONE: Self = Self { time: f64::NAN, rise: f64::NAN };
}

/// Thresholds, and a middle that may go along a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Levels {
    /// Arms the detector at or below.
    pub low: f64,
    /// Fires it at or above.
    pub high: f64,
    /// At sample `origin`.
    pub middle: f64,
    /// Of the middle, per sample.
    pub slope: f64,
    /// Where the middle is `middle`.
    pub origin: u64,
}

impl Levels {
    /// The middle at a sample not before `origin`.
    #[inline]
    pub(super) fn middle_at(&self, sample: u64) -> f64 {
        self.middle + self.slope * sample.wrapping_sub(self.origin).cast_signed() as f64
    }

    pub(super) fn check(&self) -> Result<()> {
        let Self { low, high, middle, slope, .. } = *self;
        require(
            low.is_finite() && high.is_finite() && low < middle && middle < high && slope.is_finite(),
            || {
                format!(
                    "levels must be finite with low < middle < high, got low {low}, middle {middle}, high {high}"
                )
            },
        )
    }
}
