//! Dead time of the governor's command, possibly zero, for commands at every step or at a clock.

use std::collections::VecDeque;

use crate::subnormal::cut;

use super::inputs::Span;
use super::parameters::{Parameters, at};

/// Delayed commands: for each of the last steps the value at its beginning and end.
///
/// A sampling governor holds its command over a period. To fourth order, the effect of such a hold is the mean of two
/// delayed commands at Gauss points, which are a period over the root of 12 before and after the hold's middle.
#[derive(Debug)]
pub struct DeadTime {
    ring: Vec<(f64, f64)>,
    reader: Reader,
    /// Reader of the second Gauss point.
    second: Option<Reader>,
    is_none: bool,
}

/// A delay as whole steps and a fraction.
#[derive(Debug, Clone, Copy)]
struct Reader {
    whole: usize,
    part: f64,
    /// Delayed command at the end of the last step.
    last: f64,
}

impl Reader {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    fn new(delay: f64, h: f64, still: f64) -> Self {
        let whole = (delay / h).floor();
        Self { whole: whole as usize, part: delay * (1.0 / h) - whole, last: still }
    }

    #[inline(always)]
    fn over(&self, ring: &[(f64, f64)], at: usize, start: f64, end: f64) -> Span {
        let of = |steps: usize| ring[at.wrapping_sub(steps) & (ring.len() - 1)];
        let (first, last) = if self.whole == 0 { (start, end) } else { of(self.whole) };
        let left = of(self.whole + 1).1;
        // With a delay of whole steps, a jump arrives exactly at the beginning of a step.
        let from = if self.part == 0.0 { first } else { self.last };
        let to = last + (first - last) * self.part;
        let mean = (first + to + (from - to + (left - first)) * self.part) * 0.5;
        Span { start: from, end: to, mean }
    }

    #[inline(always)]
    fn keep(&mut self, ring: &[(f64, f64)], at: usize, start: f64, end: f64) {
        let (first, last) =
            if self.whole == 0 { (start, end) } else { ring[at.wrapping_sub(self.whole) & (ring.len() - 1)] };
        self.last = last + (first - last) * self.part;
    }

    fn at_once(&self) -> f64 {
        if self.whole == 0 { 1.0 - self.part } else { 0.0 }
    }
}

impl DeadTime {
    /// A delay [s] in steps of `h`; `hold` is the share of the delay that is due to a hold. Before the start the command
    /// is `still`.
    pub fn new(delay: f64, hold: Option<f64>, h: f64, still: f64) -> Self {
        let apart = hold.map(|share| delay * share * (1.0 / 3.0_f64.sqrt()));
        let reader = Reader::new(apart.map_or(delay, |apart| delay + apart), h, still);
        Self {
            ring: vec![(still, still); (reader.whole + 2).next_power_of_two()],
            reader,
            second: apart.map(|apart| Reader::new(delay - apart, h, still)),
            is_none: reader.whole == 0 && reader.part == 0.0,
        }
    }

    /// Delayed command over step `at`; the command of this step changes linearly from `start` to `end`.
    #[inline(always)]
    pub fn over(&self, at: usize, start: f64, end: f64) -> Span {
        if self.is_none {
            return Span { start, end, mean: (start + end) * 0.5 };
        }
        let found = self.reader.over(&self.ring, at, start, end);
        let Some(second) = &self.second else { return found };
        let other = second.over(&self.ring, at, start, end);
        Span {
            start: (found.start + other.start) * 0.5,
            end: (found.end + other.end) * 0.5,
            mean: (found.mean + other.mean) * 0.5,
        }
    }

    /// Share of a command at a step's end that acts at the same instant.
    pub fn at_once(&self) -> f64 {
        let first = self.reader.at_once();
        self.second.as_ref().map_or(first, |second| (first + second.at_once()) * 0.5)
    }

    /// Set decayed values to zero.
    pub fn cut(&mut self) {
        self.reader.last = cut(self.reader.last);
        if let Some(second) = &mut self.second {
            second.last = cut(second.last);
        }
    }

    /// Store the command of step `at`.
    #[inline(always)]
    pub fn keep(&mut self, at: usize, start: f64, end: f64) {
        if self.is_none {
            return;
        }
        self.reader.keep(&self.ring, at, start, end);
        if let Some(second) = &mut self.second {
            second.keep(&self.ring, at, start, end);
        }
        let mask = self.ring.len() - 1;
        self.ring[at & mask] = (start, end);
    }
}

/// A governor with a clock, which holds its command between samples.
#[derive(Debug)]
pub struct Clock {
    /// Sample period [s].
    pub period: f64,
    /// Time of the first sample, or of the last one if the governor samples at firings [s].
    pub first: f64,
    /// Time of the next sample [s].
    pub next: f64,
    /// Number of samples taken.
    pub taken: usize,
    /// Whether the integral includes an error before it is used.
    pub sums_first: bool,
    /// Whether the governor samples when a cylinder fires.
    pub at_firings: bool,
    /// Delayed commands: times of arrival and values.
    pub coming: VecDeque<(f64, f64)>,
    /// The acting command.
    pub acting: f64,
}

impl Clock {
    /// None for a continuous governor.
    pub fn new(parameters: &Parameters, acting: f64, at_firings: bool) -> Option<Self> {
        (parameters.of(at::T_S) > 0.0).then(|| Self {
            period: parameters.of(at::T_S),
            first: parameters.of(at::T_0),
            next: parameters.of(at::T_0),
            taken: 0,
            sums_first: parameters.of(at::UPDATE) == 1.0,
            at_firings,
            coming: VecDeque::new(),
            acting,
        })
    }
}
