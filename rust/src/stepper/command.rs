//! The governor's command on its way to the rack: a dead time, from none on, for commands at every step or at a clock.

use std::collections::VecDeque;

use crate::subnormal::cut;

use super::inputs::Span;
use super::parameters::{Parameters, at};

/// Commands of the last steps, read late: of each step the value at its begin and at its end.
///
/// A governor that samples holds its command over a period. The mean of such a hold is, to fourth order, that of two
/// commands: Gauss's two points, a period over the root of 12 on either side of its middle.
#[derive(Debug)]
pub struct DeadTime {
    ring: Vec<(f64, f64)>,
    reader: Reader,
    /// The second of two points.
    second: Option<Reader>,
    is_none: bool,
}

/// One delay, as whole steps and a part of one.
#[derive(Debug, Clone, Copy)]
struct Reader {
    whole: usize,
    part: f64,
    /// The late command at the end of the last step.
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
        // At a whole number of steps a jump has just arrived.
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
    /// A delay [s], of which a hold makes up the share `hold`, in steps of `h`, before which the command stood at `still`.
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

    /// The late command over the step `at`, whose own command runs from `start` to `end`.
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

    /// Share of a command, given at a step's end, that acts at that same instant.
    pub fn at_once(&self) -> f64 {
        let first = self.reader.at_once();
        self.second.as_ref().map_or(first, |second| (first + second.at_once()) * 0.5)
    }

    /// Take what has died away for zero.
    pub fn cut(&mut self) {
        self.reader.last = cut(self.reader.last);
        if let Some(second) = &mut self.second {
            second.last = cut(second.last);
        }
    }

    /// Keep the command of the step `at`.
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

/// A governor that computes at its own clock and holds its command in between.
#[derive(Debug)]
pub struct Clock {
    /// Sampling period, first sample (the last one, where it samples at firings) and next sample [s], and the samples taken.
    pub period: f64,
    pub first: f64,
    pub next: f64,
    pub taken: usize,
    /// Whether the sum takes an error before it is used.
    pub sums_first: bool,
    /// Whether it samples as a cylinder fires.
    pub at_firings: bool,
    /// Commands under way: when they arrive, and what they are.
    pub coming: VecDeque<(f64, f64)>,
    /// The command that acts.
    pub acting: f64,
}

impl Clock {
    /// None where the governor computes all the time.
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
