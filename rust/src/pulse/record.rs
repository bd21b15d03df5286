//! Pulses of a whole record: its windows one after the other, those that go on as before looked at several at a time.

use std::collections::VecDeque;
use std::num::NonZero;
use std::thread::available_parallelism;

use super::sample::Sample;
use super::steady::{Held, Steady};
use super::timing::Timing;
use super::tracker::{PulseTracker, Pulses};
use crate::error::{Error, Result, require};
use crate::stop::Stop;

/// Most windows that are looked at ahead, by all threads together.
const AHEAD: usize = 64;
/// Samples of a record from which on other threads take part.
const LONG: usize = 1 << 20;

/// Pulses of many windows.
#[derive(Debug, Default)]
pub struct Record {
    /// Times, in samples.
    pub times: Vec<f64>,
    /// Of the train at each.
    pub heights: Vec<f64>,
    /// Standard deviations of the times.
    pub timing: Timing,
    /// Low, high and middle, each time they changed.
    pub levels: Vec<[f64; 3]>,
    /// Of each window: number of pulses, height from which on a pulse can't be noise, least and median height.
    pub windows: Vec<[f64; 4]>,
}

impl Record {
    /// Take the next window's.
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

/// The mean of the middle two where there is no middle one.
fn median(values: &mut [f64]) -> f64 {
    let half = values.len() / 2;
    let even = values.len().is_multiple_of(2);
    let (below, &mut upper, _) = values.select_nth_unstable_by(half, f64::total_cmp);
    if even { f64::midpoint(below.iter().copied().fold(f64::NEG_INFINITY, f64::max), upper) } else { upper }
}

impl PulseTracker {
    /// Look at the windows of a record and take their crossings, as by [`Self::look`] and [`Self::cross`].
    ///
    /// # Errors
    /// As these, or for a window without samples.
    pub fn follow<T: Sample>(&mut self, samples: &[T], window: usize, stop: &Stop) -> Result<Record> {
        require(window > 0, || "window: found 0, expected samples in it".to_owned())?;
        let threads = if samples.len() < LONG { 1 } else { available_parallelism().map_or(1, NonZero::get) };
        let mut record = Record::default();
        let mut ahead: VecDeque<Option<Held>> = VecDeque::new();
        let mut most = threads;
        let mut before: Option<&[T]> = None;
        for (first, part) in (0..).step_by(window).zip(samples.chunks(window)) {
            let Some(steady) = self.steady.filter(|_| threads > 1) else {
                self.look(part, stop)?;
                self.take(&mut record, before.replace(part), stop)?;
                most = threads;
                continue;
            };
            if ahead.is_empty() {
                ahead = foreseen(&steady, samples, first, window, (most, threads), stop)?;
                most = (2 * most).min(AHEAD.max(threads));
            }
            let held = ahead.pop_front().flatten();
            if held.is_none() {
                ahead.clear();
            }
            self.take_in(part, held, stop)?;
            self.take(&mut record, before.replace(part), stop)?;
        }
        self.take(&mut record, before, stop)?;
        Ok(record)
    }

    fn take<T: Sample>(&mut self, record: &mut Record, window: Option<&[T]>, stop: &Stop) -> Result<()> {
        if let Some(window) = window {
            record.push(self.cross(window, stop)?);
        }
        Ok(())
    }
}

/// Where the next windows, at most `most`, go on as before; each of `threads` looks at some in a row.
fn foreseen<T: Sample>(
    steady: &Steady,
    samples: &[T],
    first: usize,
    window: usize,
    (most, threads): (usize, usize),
    stop: &Stop,
) -> Result<VecDeque<Option<Held>>> {
    let starts: Vec<usize> = (first..samples.len()).step_by(window).take(most).collect();
    let look = |starts: &[usize]| -> Result<Vec<Option<Held>>> {
        let mut found = Vec::with_capacity(starts.len());
        for &start in starts {
            let length = window.min(samples.len() - start);
            found.push(steady.holds_later(samples, start, length, stop)?);
        }
        Ok(found)
    };
    let mut shares = starts.chunks(starts.len().div_ceil(threads).max(1));
    let own = shares.next().unwrap_or_default();
    std::thread::scope(|scope| {
        let others: Vec<_> = shares
            .map(|share| {
                std::thread::Builder::new()
                    .spawn_scoped(scope, move || look(share))
                    .map_err(|error| Error::Internal(format!("can't start a thread: {error}")))
            })
            .collect::<Result<_>>()?;
        let mut found = VecDeque::from(look(own)?);
        for other in others {
            found.extend(other.join().map_err(|_| Error::Internal("a look ahead ended".to_owned()))??);
        }
        Ok(found)
    })
}
