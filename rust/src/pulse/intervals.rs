//! Speeds over the intervals between pulses, with standard deviations.

use std::ops::Range;

use crate::error::{Result, require};
use crate::stop::Stop;

/// Number of neighbouring intervals whose mean length is the expected length of an interval.
const AROUND: usize = 33;
/// Least share of the sampling variance that remains: it is never certain that two pulses are exactly a whole number of
/// samples apart.
const LEAST_APART: f64 = 0.05;
/// Standard deviation [samples] above which an edge counts as a step, not as a slope.
const STEP: f64 = 0.2;
/// Largest relative correction of a speed.
const MOST_SURPLUS: f64 = 0.5;
/// Half width, in periods, of the running median against which missed and extra pulses are detected.
const REACH: usize = 10;
/// Periods whose extremes are compared together.
const BLOCK: usize = 64;

/// Pulses between two breaks.
#[derive(Debug, Clone, Copy)]
pub struct Counted<'a> {
    /// Times of the edges [s].
    pub edges: &'a [f64],
    /// Number of true intervals from each edge to the next.
    pub count: &'a [i64],
    /// Angles of a revolution's intervals [rev]; the first angle is the angle of the track's first interval.
    pub fractions: &'a [f64],
    /// Relative standard deviations of the angles in `fractions`.
    pub relative: &'a [f64],
    /// Standard deviations of the edges from noise [s]: one, or one per edge.
    pub noise: &'a [f64],
    /// Standard deviations of the edges from sampling [s].
    pub grid: &'a [f64],
    /// Sample time [s]; 0: unknown.
    pub sample: f64,
}

/// Columns of the results.
pub const COLUMNS: usize = 6;
/// Intervals that are processed together, so that intermediate results stay in the cache.
const TOGETHER: usize = 2048;

/// Relative statistics of the speed over an interval.
#[derive(Clone, Copy)]
struct Scatter {
    random: f64,
    sampled: f64,
    /// Share of the variance from sampling that remains, since the errors of both edges are correlated.
    alike: f64,
    /// Excess of the mean of 1 / T over 1 / (mean of T), relative to the variance from sampling.
    surplus: f64,
}

/// Mean speeds over the intervals between pulses, in columns: middle [s], speed [rev/s], its deviation, length [s], angle
/// [rev], and deviation for independent errors of the ends.
///
/// # Errors
/// If lengths do not match, or a count is not positive; on a stop.
pub fn interval_speeds(track: &Counted<'_>, columns: [&mut [f64]; COLUMNS], stop: &Stop) -> Result<()> {
    let wholes = track.edges.len().saturating_sub(1);
    require(wholes > 0 && track.count.len() == wholes, || {
        format!(
            "count: found {} of them, expected one less than edges, {}",
            track.count.len(),
            track.edges.len()
        )
    })?;
    let turn = track.fractions.len();
    require(turn > 0 && track.relative.len() == turn, || {
        format!("relative: found {} of them, expected as many as fractions, {turn}", track.relative.len())
    })?;
    for (name, stds) in [("noise", track.noise), ("grid", track.grid)] {
        require(stds.len() == 1 || stds.len() == track.edges.len(), || {
            format!(
                "{name}: found {} of them, expected 1 or one for each edge, {}",
                stds.len(),
                track.edges.len()
            )
        })?;
    }
    require(track.count.iter().all(|&count| (1..1 << 20).contains(&count)), || {
        "count: expected 1 or more true intervals between two edges".to_owned()
    })?;
    let total = usize::try_from(track.count.iter().sum::<i64>()).unwrap_or(usize::MAX);
    require(columns.iter().all(|column| column.len() == total), || {
        format!("columns: found {} rows, expected the counts' sum, {total}", columns[0].len())
    })?;
    Pass { track, turned: track.turned(), around: AROUND.min(wholes) }.fill(columns, stop)
}

/// Angle of each interval [rev]; a single value if all are equal.
enum Turned {
    Equal(f64),
    Each(Vec<f64>),
}

impl Turned {
    fn at(&self, index: usize) -> f64 {
        match self {
            Self::Equal(one) => *one,
            Self::Each(angles) => angles[index],
        }
    }
}

impl Counted<'_> {
    fn turned(&self) -> Turned {
        if let [one] = self.fractions
            && self.count.iter().all(|&count| count == 1)
        {
            return Turned::Equal(*one);
        }
        let mut places = (0..self.fractions.len()).cycle();
        let angle =
            |&count: &i64| (0..count).filter_map(|_| places.next()).map(|place| self.fractions[place]).sum();
        Turned::Each(self.count.iter().map(angle).collect())
    }
}

struct Pass<'a> {
    track: &'a Counted<'a>,
    turned: Turned,
    around: usize,
}

impl Pass<'_> {
    fn fill(&self, columns: [&mut [f64]; COLUMNS], stop: &Stop) -> Result<()> {
        let [middles, speeds, stds, durations, angles, ends] = columns;
        let Counted { edges, count, fractions, relative, .. } = *self.track;
        let (mut row, mut place, mut passed) = (0, 0, 0.0);
        for first in (0..count.len()).step_by(TOGETHER) {
            stop.check()?;
            let part = first..(first + TOGETHER).min(count.len());
            let (expected, scatters) = self.scatters(&part);
            for ((k, usual), Scatter { random, sampled, alike, surplus }) in part.zip(expected).zip(scatters)
            {
                let speed = self.turned.at(k) / (edges[k + 1] - edges[k]);
                let usual = self.turned.at(k) / usual;
                let unbiased = speed * (1.0 - (random + sampled * surplus).min(MOST_SURPLUS));
                for _ in 0..count[k] {
                    let variance = relative[place] * relative[place] + random;
                    durations[row] = fractions[place] / speed;
                    passed += durations[row];
                    middles[row] = edges[0] + passed - durations[row] / 2.0;
                    speeds[row] = unbiased;
                    stds[row] = usual * (variance + sampled * alike).sqrt();
                    angles[row] = fractions[place];
                    ends[row] = usual * (variance + sampled).sqrt();
                    row += 1;
                    place = if place + 1 == fractions.len() { 0 } else { place + 1 };
                }
            }
        }
        Ok(())
    }

    /// Expected lengths of some intervals [s], and statistics of their speeds.
    fn scatters(&self, part: &Range<usize>) -> (Vec<f64>, Vec<Scatter>) {
        let (track, wholes) = (self.track, self.track.count.len());
        // Moving averages also need the intervals before and after the range.
        let wide = part.start.saturating_sub(self.around)..(part.end + self.around).min(wholes);
        let mut expected = self.means(&wide, |k| track.edges[k + 1] - track.edges[k]);
        if let Turned::Each(angles) = &self.turned {
            let usual = self.means(&wide, |k| angles[k]);
            expected
                .iter_mut()
                .zip(usual)
                .zip(&angles[wide.clone()])
                .for_each(|((x, mean), own)| *x *= own / mean);
        }
        let each: Vec<Scatter> =
            expected.iter().zip(wide.clone()).map(|(x, k)| self.scatter(k, *x)).collect();
        let mut own = each[part.start - wide.start..part.end - wide.start].to_vec();
        if track.sample > 0.0 {
            let alike = self.means(part, |k| each[k - wide.start].alike);
            let surplus = self.means(part, |k| each[k - wide.start].surplus);
            for ((scatter, alike), surplus) in own.iter_mut().zip(alike).zip(surplus) {
                (scatter.alike, scatter.surplus) = (alike.max(LEAST_APART), surplus.max(LEAST_APART));
            }
        }
        expected.drain(..part.start - wide.start);
        expected.truncate(part.len());
        (expected, own)
    }

    fn scatter(&self, k: usize, expected: f64) -> Scatter {
        let squares = |stds: &[f64]| match stds {
            [one] => 2.0 * one * one,
            _ => stds[k] * stds[k] + stds[k + 1] * stds[k + 1],
        };
        let inverse = 1.0 / (expected * expected);
        let (random, sampled) = (squares(self.track.noise) * inverse, squares(self.track.grid) * inverse);
        let none = Scatter { random, sampled, alike: 1.0, surplus: 1.0 };
        if self.track.sample <= 0.0 {
            return none;
        }
        // Two edges have equal sampling errors if a whole number of samples is between them. While the speed changes, the
        // number of samples varies, and `alike` averages to 1 over several intervals.
        let samples = expected / self.track.sample;
        let whole = samples.floor().max(1.0);
        let past = samples - whole;
        if sampled * samples * samples > 2.0 * STEP * STEP {
            // There are `whole` samples or one more between two steps, so 1 / T has two values.
            let (alike, few) = (6.0 * past * (1.0 - past), samples * samples / (whole * (whole + 1.0)));
            Scatter { alike: alike * few * few, surplus: alike * few, ..none }
        } else {
            let alike = 1.0 - (std::f64::consts::TAU * past).cos();
            Scatter { alike, surplus: alike, ..none }
        }
    }

    /// Moving averages around each value of a range, reflected at the track's ends.
    fn means(&self, part: &Range<usize>, value: impl Fn(usize) -> f64) -> Vec<f64> {
        let (size, before, count) = (self.around, self.around / 2, self.track.count.len());
        // Indices start `before` values ahead of the track.
        let at = |place: usize| {
            let index = if place < before { before - 1 - place } else { place - before };
            value(if index < count { index } else { 2 * count - 1 - index })
        };
        let mut sum: f64 = (part.start..part.start + size).map(at).sum();
        let share = 1.0 / size as f64;
        part.clone()
            .map(|place| {
                let mean = sum * share;
                let inner = place >= before && place + size < count + before;
                sum += if inner {
                    value(place + size - before) - value(place - before)
                } else if place + 1 < part.end {
                    at(place + size) - at(place)
                } else {
                    0.0
                };
                mean
            })
            .collect()
    }
}

/// Whether the ratio of each period to each of the ten before and after it is at least `least` and below `most`. The ratio to
/// their median then is too.
///
/// # Errors
/// On a stop.
pub fn is_even(times: &[f64], least: f64, most: f64, stop: &Stop) -> Result<bool> {
    const { assert!(BLOCK >= REACH) };
    let periods = times.len().saturating_sub(1);
    let extremes = (0..periods)
        .step_by(BLOCK)
        .map(|first| {
            stop.check()?;
            let part = &times[first..=(first + BLOCK).min(periods)];
            let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
            for (one, next) in part.iter().zip(&part[1..]) {
                let period = next - one;
                low = if period < low { period } else { low };
                high = if period > high { period } else { high };
            }
            Ok((low, high))
        })
        .collect::<Result<Vec<(f64, f64)>>>()?;
    Ok(extremes.iter().enumerate().all(|(block, &(low, high))| {
        let near = &extremes[block.saturating_sub(1)..(block + 2).min(extremes.len())];
        let lowest = near.iter().fold(f64::INFINITY, |found, pair| found.min(pair.0));
        let highest = near.iter().fold(f64::NEG_INFINITY, |found, pair| found.max(pair.1));
        low >= least * highest && high < most * lowest
    }))
}
