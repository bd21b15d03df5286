//! Thresholds of the pulse detector, and the crossings that it detects.

use super::sample::Sample;
use crate::error::{Error, Result, require};

/// An upward crossing of the middle: its time, and the rise of the signal between the two samples around it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge {
    /// Time in samples from the first.
    pub time: f64,
    /// Rise between the two samples; infinite if a sample is saturated, or if new levels caused the crossing.
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

/// Thresholds, and a middle that may change linearly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Levels {
    /// Threshold at or below which the detector is armed.
    pub low: f64,
    /// Threshold at or above which it fires.
    pub high: f64,
    /// Middle at sample `origin`.
    pub middle: f64,
    /// Slope of the middle, per sample.
    pub slope: f64,
    /// Sample at which the middle is `middle`.
    pub origin: u64,
}

impl Levels {
    /// The middle at a sample not before `origin`.
    #[inline]
    pub(super) fn middle_at(&self, sample: u64) -> f64 {
        self.middle + self.slope * sample.wrapping_sub(self.origin).cast_signed() as f64
    }

    /// Low and high threshold in the samples' type; comparisons with them give the same results as in f64.
    ///
    /// # Errors
    /// If the samples' type can't represent a threshold.
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
