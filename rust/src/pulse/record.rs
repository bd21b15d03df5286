//! Pulses of a whole record, window by window.

use super::sample::Sample;
use super::timing::Timing;
use super::tracker::{PulseTracker, Pulses};
use crate::error::{Result, require};
use crate::stop::Stop;

/// Pulses of many windows.
#[derive(Debug, Default)]
pub struct Record {
    /// Times, in samples.
    pub times: Vec<f64>,
    /// Height of the train at each time.
    pub heights: Vec<f64>,
    /// Standard deviations of the times.
    pub timing: Timing,
    /// Low, high and middle at each change.
    pub levels: Vec<[f64; 3]>,
    /// For each window: number of pulses, height above which a pulse can't be noise, least and median height.
    pub windows: Vec<[f64; 4]>,
}

impl Record {
    /// Add the next window's pulses.
    pub fn push(&mut self, pulses: Pulses) {
        let mut heights = pulses.heights;
        self.heights.extend_from_slice(&heights);
        let least = heights.iter().copied().fold(f64::INFINITY, f64::min);
        let most = heights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let middle = if least < most { median(&mut heights) } else { most };
        self.windows.push([pulses.times.len() as f64, pulses.limit, least, middle]);
        self.times.extend(pulses.times);
        self.timing.grid.extend(pulses.timing.grid);
        self.timing.noise.extend(pulses.timing.noise);
        self.levels.extend(pulses.levels);
    }
}

/// Median; the mean of the middle two for an even count.
fn median(values: &mut [f64]) -> f64 {
    let half = values.len() / 2;
    let even = values.len().is_multiple_of(2);
    let (below, &mut upper, _) = values.select_nth_unstable_by(half, f64::total_cmp);
    if even { f64::midpoint(below.iter().copied().fold(f64::NEG_INFINITY, f64::max), upper) } else { upper }
}

impl PulseTracker {
    /// Process the windows of a record by [`Self::look`] and [`Self::cross`].
    ///
    /// # Errors
    /// Errors of [`Self::look`] and [`Self::cross`], and [`Error::Invalid`] for a window without samples.
    pub fn follow<T: Sample>(&mut self, samples: &[T], window: usize, stop: &Stop) -> Result<Record> {
        require(window > 0, || "window: found 0, expected samples in it".to_owned())?;
        let mut record = Record::default();
        let mut before: Option<&[T]> = None;
        for part in samples.chunks(window) {
            self.look(part, stop)?;
            if let Some(before) = before.replace(part) {
                record.push(self.cross(before, stop)?);
            }
        }
        if let Some(last) = before {
            record.push(self.cross(last, stop)?);
        }
        Ok(record)
    }
}
