//! Thresholds of the detector of pulses, and the crossings that it finds.

use super::sample::Sample;
use crate::error::{Error, Result, require};

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

impl From<Edge> for f64 {
    fn from(edge: Edge) -> Self {
        edge.time
    }
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

    /// Low and high threshold in the samples' type; a comparison with them gives the same as in f64.
    ///
    /// # Errors
    /// Where the samples' type cannot hold one of the two.
    pub(super) fn thresholds<T: Sample>(&self) -> Result<(T, T)> {
        let outside = |name: &str, level: f64| {
            Error::Invalid(format!(
                "{name} = {level} is outside the range of {} samples; give levels in their unit",
                T::NAME
            ))
        };
        let low = T::at_or_below(self.low).ok_or_else(|| outside("low", self.low))?;
        let high = T::at_or_above(self.high).ok_or_else(|| outside("high", self.high))?;
        Ok((low, high))
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
