//! What a record shows of a simulation: gaps bridged as the data's are, and one low-pass for model and data.

use pulp::{Simd, WithSimd};

use crate::error::{Result, require};
use crate::instruction_set::arch;
use crate::stop::{CHECK_EVERY, Stop};

/// A symmetric low-pass of an odd number of taps, every `down`-th value of which is kept; ends stand still.
#[derive(Debug, Clone, Copy)]
pub struct Decimation<'a> {
    /// Taps, the middle one at the sample itself.
    pub taps: &'a [f64],
    /// Samples between two values that are kept.
    pub down: usize,
}

impl Decimation<'_> {
    /// Number of values that are left of so many samples.
    #[must_use]
    pub const fn left(&self, samples: usize) -> usize {
        samples.div_ceil(self.down)
    }
}

/// Bridge gaps of rows `[sample, width]` with straight lines and low-pass them into `seen` `[width, left]`.
///
/// `masked` marks, sample by sample and output by output, what the record has not; an output is `width / outputs` columns.
///
/// # Errors
/// [`Error::Invalid`](crate::error::Error::Invalid) for lengths that don't fit, [`Error::Stopped`](crate::error::Error::Stopped)
/// on request.
pub fn observe(
    rows: &mut [f64],
    masked: &[bool],
    outputs: usize,
    low_pass: &Decimation<'_>,
    seen: &mut [f64],
    stop: &Stop,
) -> Result<()> {
    let samples = masked.len() / outputs.max(1);
    let width = rows.len() / samples.max(1);
    require(samples > 0 && low_pass.down > 0 && low_pass.taps.len() % 2 == 1, || {
        "expected samples, a step of 1 or more and an odd number of taps".to_owned()
    })?;
    let left = low_pass.left(samples);
    require(rows.len() == samples * width && seen.len() == width * left, || {
        format!("found room for {} values, expected {}", seen.len(), width * left)
    })?;
    let part = width / outputs;
    for output in 0..outputs {
        bridge(rows, width, output * part..(output + 1) * part, |k| masked[k * outputs + output], samples);
    }
    arch().dispatch(Filter { rows, width, low_pass, seen, stop })
}

struct Filter<'a> {
    rows: &'a [f64],
    width: usize,
    low_pass: &'a Decimation<'a>,
    seen: &'a mut [f64],
    stop: &'a Stop,
}

impl WithSimd for Filter<'_> {
    type Output = Result<()>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> Result<()> {
        let Self { rows, width, low_pass, seen, stop } = self;
        let between = (CHECK_EVERY / low_pass.taps.len()).max(1);
        let (samples, half) = (rows.len() / width, low_pass.taps.len() / 2);
        let left = low_pass.left(samples);
        let mut sum = vec![0.0; width];
        for kept in 0..left {
            if kept % between == 0 {
                stop.check()?;
            }
            sum.fill(0.0);
            let centre = kept * low_pass.down;
            for (tap, &weight) in low_pass.taps.iter().enumerate() {
                let at = (centre + tap).saturating_sub(half).min(samples - 1);
                for (sum, value) in sum.iter_mut().zip(&rows[at * width..(at + 1) * width]) {
                    *sum += value * weight;
                }
            }
            for (column, value) in sum.iter().enumerate() {
                seen[column * left + kept] = *value;
            }
        }
        Ok(())
    }
}

fn bridge(
    rows: &mut [f64],
    width: usize,
    columns: std::ops::Range<usize>,
    is_masked: impl Fn(usize) -> bool,
    samples: usize,
) {
    let mut k = 0;
    while k < samples {
        if !is_masked(k) {
            k += 1;
            continue;
        }
        let first = k;
        while k < samples && is_masked(k) {
            k += 1;
        }
        for at in first..k {
            for column in columns.clone() {
                let value = match (first.checked_sub(1), k < samples) {
                    (Some(before), true) => {
                        let share = (at - before) as f64 / (k - before) as f64;
                        let (low, high) = (rows[before * width + column], rows[k * width + column]);
                        low + (high - low) * share
                    }
                    (Some(before), false) => rows[before * width + column],
                    (None, true) => rows[k * width + column],
                    (None, false) => 0.0,
                };
                rows[at * width + column] = value;
            }
        }
    }
}
