//! Pulses of a train with changing levels; levels are estimated one window ahead of the crossings.

use std::collections::VecDeque;

use super::crossings::PulseCrossings;
use super::heights::{STEADY, heights_along, ratio};
use super::levels::pulse_levels;
use super::noise::{noises, quarter};
use super::sample::Sample;
use super::steady::{Held, Steady};
use super::swings::{Grouping, Level, Swings, block_extremes, reversal};
use super::thresholds::{Edge, Levels};
use super::timing::Timing;
use crate::error::{Error, Result, require};
use crate::stop::Stop;

/// Distance between the thresholds as a share of the distance between the levels.
const HYSTERESIS: f64 = 0.4;
/// Largest share for large noise; with a larger one, pulses of few samples would not reach the thresholds.
const WIDEST: f64 = 0.6;
/// Distance between the thresholds, in standard deviations of the noise, at which noise alone never crosses both.
const BRIDGED: f64 = 8.4;
/// Height of a pulse, in standard deviations of the noise, above which it can't be noise: `BRIDGED / WIDEST`.
const LIMIT: f64 = 14.0;
/// Largest changes for which the previous levels are kept: change of the middle relative to the noise, and relative
/// change of the height.
const SAME_MIDDLE: f64 = 0.5;
const SAME_HEIGHT: f64 = 0.05;
/// Number of stretches whose noise is averaged, and least number of them that each window contributes.
const STRETCHES: usize = 64;
const LEAST_STRETCHES: usize = 4;
/// Ratio of a window's noise to the noise of the previous windows, above which the noise has changed.
const CHANGED: f64 = 1.5;

/// Crossings of a window.
#[derive(Debug, Clone, Default)]
pub struct Pulses {
    /// Times in samples from the record's first.
    pub times: Vec<f64>,
    /// Height of the train at each crossing; 0 without turning points nearby.
    pub heights: Vec<f64>,
    /// Standard deviations of the times [samples], from sampling and from noise.
    pub timing: Timing,
    /// Low, high and middle at each change.
    pub levels: Vec<[f64; 3]>,
    /// Height above which a pulse can't be noise.
    pub limit: f64,
}

/// Thresholds that apply from a sample on, and the height of the train.
#[derive(Debug, Clone, Copy)]
struct Piece {
    start: u64,
    levels: Levels,
    height: f64,
}

/// A window whose levels are estimated.
#[derive(Debug, Clone)]
struct Window {
    length: usize,
    noise: f64,
    /// The train's state at the window's start, and crossings within; None unless the window continues earlier pulses.
    held: Option<(Steady, Held)>,
}

/// Tracks the levels of a train and detects its crossings.
#[derive(Debug, Clone)]
pub struct PulseTracker {
    threshold: Option<f64>,
    hysteresis: Option<f64>,
    swings: Swings,
    grouping: Grouping,
    levels: VecDeque<Level>,
    looked: u64,
    windows: VecDeque<Window>,
    detector: PulseCrossings,
    extremes: Vec<(f64, f64)>,
    /// Noise of the last stretches.
    stretches: VecDeque<f64>,
    /// State after the last window; None if its levels changed.
    steady: Option<Steady>,
}

impl PulseTracker {
    /// A tracker before its first window. A given threshold, or distance between the thresholds, remains constant.
    ///
    /// # Errors
    /// For invalid numbers.
    pub fn new(threshold: Option<f64>, hysteresis: Option<f64>) -> Result<Self> {
        require(threshold.is_none_or(f64::is_finite), || {
            format!("threshold: found {}, expected a finite number", threshold.unwrap_or_default())
        })?;
        require(hysteresis.is_none_or(|width| width.is_finite() && width > 0.0), || {
            format!("hysteresis: found {:?}, expected a positive number", hysteresis.unwrap_or_default())
        })?;
        Ok(Self {
            threshold,
            hysteresis,
            swings: Swings::default(),
            grouping: Grouping::default(),
            levels: VecDeque::new(),
            looked: 0,
            windows: VecDeque::new(),
            detector: PulseCrossings::new(-1.0, 1.0, 0.0)?,
            extremes: Vec::new(),
            stretches: VecDeque::new(),
            steady: None,
        })
    }

    /// Stretches of missing samples, as in [`PulseCrossings::gaps`].
    pub fn gaps(&self) -> impl Iterator<Item = (u64, u64)> {
        self.detector.gaps()
    }

    /// Estimate the levels of the next window.
    ///
    /// # Errors
    /// On a stop, after which the tracker is unusable.
    pub fn look<T: Sample>(&mut self, window: &[T], stop: &Stop) -> Result<()> {
        let held = self.steady.map(|steady| steady.holds(window, self.looked, stop)).transpose()?.flatten();
        self.take_in(window, held, stop)
    }

    fn take_in<T: Sample>(&mut self, window: &[T], held: Option<Held>, stop: &Stop) -> Result<()> {
        let (Some(steady), Some(held)) = (self.steady, held) else { return self.look_anew(window, stop) };
        // The remaining turning points are grouped, as at a record's end.
        let rest = std::mem::take(&mut self.grouping).rest(steady.level.noise);
        let rest: Vec<Level> = rest.into_iter().filter(|level| self.is_usable(level)).collect();
        self.levels.extend(rest);
        self.swings = Swings::default();
        let (first, length) = (self.looked, window.len() as u64);
        let (middle, quarter) = (first + length / 2, length / 4);
        for (centre, span) in
            [(first + quarter, (first, middle)), (first + length - quarter, (middle, first + length))]
        {
            self.levels.push_back(Level { centre, span, ..steady.level });
        }
        self.steady = Some(Steady { armed: held.armed, ..steady });
        self.looked += length;
        let noise = steady.level.noise;
        self.windows.push_back(Window { length: window.len(), noise, held: Some((steady, held)) });
        Ok(())
    }

    fn look_anew<T: Sample>(&mut self, window: &[T], stop: &Stop) -> Result<()> {
        stop.check()?;
        block_extremes(window, &mut self.extremes);
        let stretches = noises(window, LEAST_STRETCHES.max(STRETCHES - self.stretches.len()));
        let own = quarter(&stretches);
        self.stretches.extend(stretches);
        self.stretches.drain(..self.stretches.len().saturating_sub(STRETCHES));
        let mut pooled: Vec<f64> = self.stretches.iter().copied().collect();
        pooled.sort_by(f64::total_cmp);
        let pooled = quarter(&pooled);
        // Estimates from few stretches scatter widely; only a clear change of the noise counts.
        let alike = own < CHANGED * pooled && pooled < CHANGED * own;
        let noise = if alike { pooled } else { own };
        let mut found = Vec::new();
        let grouping = &mut self.grouping;
        self.swings.feed(&self.extremes, reversal(&self.extremes, noise), self.looked, |turn| {
            grouping.push(turn, noise, &mut found);
        });
        let every = found.len();
        found.retain(|level| self.is_usable(level));
        self.steady =
            if alike && every == found.len() { self.steady_after(window, &found, noise) } else { None };
        self.levels.extend(found);
        self.looked += window.len() as u64;
        self.windows.push_back(Window { length: window.len(), noise, held: None });
        Ok(())
    }

    /// The train's state after a window with constant levels.
    fn steady_after<T: Sample>(&self, window: &[T], found: &[Level], noise: f64) -> Option<Steady> {
        // The levels at the start of the next window, so that levels are continuous.
        let rest = self.grouping.rest(noise).into_iter().rfind(|level| self.is_usable(level));
        let level = Level { noise, ..rest.or_else(|| found.last().copied())? };
        if !found.iter().all(|other| stays(&level, other)) {
            return None;
        }
        let (levels, _) = self.levels_between(&level, &level, 0)?;
        Steady::after(window, &self.extremes, level, levels)
    }

    /// Return the crossings of the oldest window whose levels are estimated; `samples` are those of that window.
    ///
    /// # Errors
    /// If it has another length, if its type can't represent a given threshold, or on a stop, after which the tracker is
    /// unusable.
    pub fn cross<T: Sample>(&mut self, samples: &[T], stop: &Stop) -> Result<Pulses> {
        let window = self.windows.pop_front().filter(|window| window.length == samples.len());
        let mut window = window.ok_or_else(|| {
            Error::Invalid(format!(
                "samples: found {} of them, expected a window that was looked at",
                samples.len()
            ))
        })?;
        let first = self.detector.seen();
        let end = first + samples.len() as u64;
        let known = self.known(samples, window.noise, first, end, stop)?;
        let pieces = self.along(&known, first, end);
        let mut pulses = Pulses { limit: LIMIT * window.noise, ..Pulses::default() };
        if pieces.is_empty() {
            // A window without levels has no crossings; only its gaps are recorded.
            self.detector.set_levels(-1.0, 1.0, 0.0)?;
            self.detector.edges(samples, stop)?;
            self.detector.disarm();
            return Ok(pulses);
        }
        if let Some(edges) = self.known_edges(&pieces, &mut window, samples)? {
            pulses.levels.push([pieces[0].levels.low, pieces[0].levels.high, pieces[0].levels.middle]);
            pulses.heights = vec![pieces[0].height; edges.len()];
            return Ok(self.timed(pulses, edges, samples, first, &window));
        }
        let mut edges: Vec<Edge> = Vec::new();
        for (piece, next) in pieces.iter().zip(pieces[1..].iter().map(|next| next.start).chain([end])) {
            self.detector.follow(piece.levels)?;
            let part = &samples[place(piece.start, first)..place(next, first)];
            edges.append(&mut self.detector.edges(part, stop)?);
            pulses.heights.resize(edges.len(), piece.height);
            pulses.levels.push([piece.levels.low, piece.levels.high, piece.levels.middle]);
        }
        if self.threshold.is_none() || self.hysteresis.is_none() {
            pulses.heights = heights_along(&edges, &known);
        }
        Ok(self.timed(pulses, edges, samples, first, &window))
    }

    fn timed<T: Sample>(
        &mut self,
        mut pulses: Pulses,
        edges: Vec<Edge>,
        samples: &[T],
        first: u64,
        window: &Window,
    ) -> Pulses {
        pulses.timing = Timing::of(samples, first, &edges, &pulses.heights, window.noise);
        pulses.times = edges.into_iter().map(|edge| edge.time).collect();
        // Only the last two of the past levels are needed again.
        while self.levels.len() > 2 && self.levels[2].centre < first + samples.len() as u64 {
            self.levels.pop_front();
        }
        pulses
    }

    /// Known crossings of a window that continues the previous ones, if its thresholds are those of the level estimate.
    fn known_edges<T: Sample>(
        &mut self,
        pieces: &[Piece],
        window: &mut Window,
        samples: &[T],
    ) -> Result<Option<Vec<Edge>>> {
        let (Some((steady, held)), [piece]) = (window.held.take(), pieces) else { return Ok(None) };
        let known = Levels { origin: piece.levels.origin, ..steady.levels };
        if piece.levels != known {
            return Ok(None);
        }
        self.detector.follow(piece.levels)?;
        Ok(self.detector.timed(samples, (held.first, held.edges), (steady.armed, held.armed)))
    }

    /// Whether a given threshold, if any, is between the levels.
    fn is_usable(&self, level: &Level) -> bool {
        self.levels_between(level, level, 0).is_some()
    }

    /// Levels near a window; empty if the train has none.
    fn known<T: Sample>(
        &self,
        samples: &[T],
        noise: f64,
        first: u64,
        end: u64,
        stop: &Stop,
    ) -> Result<Vec<Level>> {
        let mut known: Vec<Level> = self.levels.iter().copied().collect();
        known.extend(self.grouping.rest(noise).into_iter().filter(|level| self.is_usable(level)));
        if known.is_empty() {
            let (bottom, top) = pulse_levels(samples, stop)?;
            let level = Level { centre: first, span: (first, end), bottom, top, noise };
            let given = self.threshold.is_some() && self.hysteresis.is_some();
            if given || (top - bottom > LIMIT * noise && self.is_usable(&level)) {
                known.push(level);
            }
        }
        Ok(known)
    }

    /// Thresholds between successive levels; they are constant before the first level and after the last.
    fn along(&self, known: &[Level], first: u64, end: u64) -> Vec<Piece> {
        let mut pieces: Vec<Piece> = Vec::new();
        let Some(&(mut held)) = known.first() else { return pieces };
        let mut put = |start: u64, one: &Level, other: &Level| {
            let start = start.max(first);
            if let Some((levels, height)) = self.levels_between(one, other, start)
                && start < end
            {
                if pieces.last().is_some_and(|last| last.start >= start) {
                    pieces.pop();
                }
                pieces.push(Piece { start, levels, height });
            }
        };
        put(first, &held, &held);
        for pair in known.windows(2) {
            let (one, other) = (&pair[0], &pair[1]);
            if other.centre <= first {
                held = *other;
                put(first, other, other);
                continue;
            }
            if one.centre >= end {
                break;
            }
            if stays(&held, other) {
                continue;
            }
            if ratio(one, other) <= STEADY {
                put(one.centre, one, other);
                put(other.centre, other, other);
            } else {
                put(u64::midpoint(one.span.1, other.span.0), other, other);
            }
            held = *other;
        }
        pieces
    }

    /// Thresholds, from `start` on, between two pairs of levels; None if a given threshold is not between the levels.
    fn levels_between(&self, one: &Level, other: &Level, start: u64) -> Option<(Levels, f64)> {
        let (bottom, top) = (0.5 * (one.bottom + other.bottom), 0.5 * (one.top + other.top));
        let (height, noise) = (top - bottom, one.noise.max(other.noise));
        let centre = self.threshold.unwrap_or(0.5 * (bottom + top));
        let mut width = self.hysteresis.unwrap_or(HYSTERESIS * height);
        if self.hysteresis.is_none() && height >= LIMIT * noise {
            width = width.max((BRIDGED * noise).min(WIDEST * height));
        }
        let (low, high) = match (self.threshold, self.hysteresis) {
            (Some(_), Some(_)) => (centre - 0.5 * width, centre + 0.5 * width),
            _ if !(bottom < centre && centre < top) => return None,
            // A threshold is at most halfway from the middle to a level.
            _ => (centre - 0.5 * width.min(centre - bottom), centre + 0.5 * width.min(top - centre)),
        };
        let mut levels = Levels { low, high, middle: centre, slope: 0.0, origin: start };
        let length = other.centre.saturating_sub(one.centre);
        if self.threshold.is_none() && length > 0 {
            let within = |middle: f64| middle.clamp(0.5 * (low + centre), 0.5 * (centre + high));
            let (from, to) = (within(one.middle()), within(other.middle()));
            levels.slope = (to - from) / length as f64;
            levels.origin = one.centre;
            levels.middle = from;
        }
        let sound = levels.low < levels.middle && levels.middle < levels.high;
        sound.then_some((levels, height))
    }
}

/// Whether a level counts as equal to the previous one.
fn stays(held: &Level, other: &Level) -> bool {
    (other.middle() - held.middle()).abs() <= SAME_MIDDLE * held.noise
        && (other.height() - held.height()).abs() <= SAME_HEIGHT * held.height()
}

#[allow(clippy::cast_possible_truncation)] // within a slice
fn place(sample: u64, first: u64) -> usize {
    (sample - first) as usize
}
