//! The governor's command on its way to the rack: a dead time, from none on, for commands at every step or at a clock.

use std::collections::VecDeque;

use crate::scalar::Scalar;

use super::inputs::Span;
use super::parameters::{Parameters, at};

/// Commands of the last steps, read late: of each step the value at its begin and at its end.
#[derive(Debug)]
pub struct DeadTime<T> {
    ring: Vec<(T, T)>,
    whole: usize,
    part: T,
    is_none: bool,
    /// The late command at the end of the last step.
    last: T,
}

impl<T: Scalar> DeadTime<T> {
    /// A delay [s] in steps of `h`, before which the command stood at `still`.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn new(delay: T, h: f64, still: T) -> Self {
        let whole = (delay.value() / h).floor();
        let part = delay * (1.0 / h) + (-whole);
        let is_none = whole == 0.0 && part.is_zero();
        let whole = whole as usize;
        Self {
            ring: vec![(still, still); (whole + 2).next_power_of_two()],
            whole,
            part,
            is_none,
            last: still,
        }
    }

    /// The late command over the step `at`, whose own command runs from `start` to `end`.
    #[inline(always)]
    pub fn over(&self, at: usize, start: T, end: T) -> Span<T> {
        if self.is_none {
            return Span { start, end, mean: (start + end) * 0.5 };
        }
        let mask = self.ring.len() - 1;
        let of = |steps: usize| self.ring[at.wrapping_sub(steps) & mask];
        let (first, last) = if self.whole == 0 { (start, end) } else { of(self.whole) };
        let left = of(self.whole + 1).1;
        // At a whole number of steps a jump has just arrived.
        let from = if self.part.value() == 0.0 { first } else { self.last };
        let to = last.plus_product(first - last, self.part);
        let mean = (first + to).plus_product(from - to + (left - first), self.part) * 0.5;
        Span { start: from, end: to, mean }
    }

    /// Part of a command at a step's end that has arrived by then.
    pub fn at_once(&self) -> T {
        if self.whole == 0 { self.part * -1.0 + 1.0 } else { self.part.constant(0.0) }
    }

    /// Take what has died away for zero.
    pub fn cut(&mut self) {
        self.last = self.last.cut();
    }

    /// Keep the command of the step `at`.
    #[inline(always)]
    pub fn keep(&mut self, at: usize, start: T, end: T) {
        if self.is_none {
            return;
        }
        let mask = self.ring.len() - 1;
        let (first, last) =
            if self.whole == 0 { (start, end) } else { self.ring[at.wrapping_sub(self.whole) & mask] };
        self.last = last.plus_product(first - last, self.part);
        self.ring[at & mask] = (start, end);
    }
}

/// A governor that computes at its own clock and holds its command in between.
#[derive(Debug)]
pub struct Clock<T> {
    /// Sampling period, first sample and next sample [s], and the samples taken.
    pub period: T,
    pub first: T,
    pub next: T,
    pub taken: usize,
    /// Whether the sum takes an error before it is used.
    pub sums_first: bool,
    /// Commands under way: when they arrive, and what they are.
    pub coming: VecDeque<(T, T)>,
    /// The command that acts.
    pub acting: T,
}

impl<T: Scalar> Clock<T> {
    /// None where the governor computes all the time.
    pub fn new(parameters: &Parameters, number: &impl Fn(usize) -> T, acting: T) -> Option<Self> {
        (parameters.of(at::T_S) > 0.0).then(|| Self {
            period: number(at::T_S),
            first: number(at::T_0),
            next: number(at::T_0),
            taken: 0,
            sums_first: parameters.of(at::UPDATE) == 1.0,
            coming: VecDeque::new(),
            acting,
        })
    }
}
