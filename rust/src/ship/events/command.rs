//! Commands under way to the actuator: those of a governor that samples, and the past of one that computes always.

use std::collections::VecDeque;

use crate::scalar::Scalar;

/// A stretch of a signal's past: the cubic through its ends with their slopes.
#[derive(Debug, Clone, Copy)]
pub struct Segment<T> {
    pub start: T,
    pub length: T,
    pub from: T,
    pub from_slope: T,
    pub to: T,
    pub to_slope: T,
}

impl<T: Scalar> Segment<T> {
    /// Without derivatives.
    #[inline(always)]
    fn values(&self) -> Segment<f64> {
        Segment {
            start: self.start.value(),
            length: self.length.value(),
            from: self.from.value(),
            from_slope: self.from_slope.value(),
            to: self.to.value(),
            to_slope: self.to_slope.value(),
        }
    }

    /// The signal and its slope at a time.
    #[inline(always)]
    fn at(&self, time: T) -> (T, T) {
        let place = (time - self.start) / self.length;
        let rise = self.to - self.from;
        let (first, last) = (self.from_slope * self.length - rise, rise - self.to_slope * self.length);
        // from + s rise + s (1 - s) ((1 - s) first + s last)
        let rest = place * -1.0 + 1.0;
        let bend = rest * first + place * last;
        let value = self.from + place * (rise + rest * bend);
        let slope = rise + (place * -2.0 + 1.0) * bend + place * rest * (last - first);
        (value, slope / self.length)
    }
}

/// The command of a continuous governor behind its dead time.
#[derive(Debug, Clone)]
pub struct Past<T> {
    segments: VecDeque<Segment<T>>,
    /// What it was before the record.
    before: T,
}

impl<T: Scalar> Past<T> {
    /// A command that has stood at one value so far.
    #[inline(always)]
    pub fn new(before: T) -> Self {
        Self { segments: VecDeque::new(), before }
    }

    /// Add a stretch; it begins where the last one ends.
    #[inline(always)]
    pub fn push(&mut self, segment: Segment<T>) {
        self.segments.push_back(segment);
    }

    /// Take back the last stretch.
    #[inline(always)]
    pub fn pop(&mut self) {
        self.segments.pop_back();
    }

    /// Forget what ended at a time or before.
    #[inline(always)]
    pub fn forget(&mut self, time: f64) {
        while self.segments.front().is_some_and(|first| first.start.value() + first.length.value() < time) {
            self.segments.pop_front();
        }
    }

    /// The stretch that a time lies in; None: before the record.
    #[inline(always)]
    fn find(&self, within: f64) -> Option<&Segment<T>> {
        if within < 0.0 {
            return None;
        }
        let after = self.segments.partition_point(|segment| segment.start.value() <= within);
        self.segments.get(after.saturating_sub(1))
    }

    /// The command and its slope at a time, by the stretch in which `within` lies: which side of a jump is meant.
    #[inline(always)]
    pub fn at(&self, time: T, within: f64) -> (T, T) {
        match self.find(within) {
            Some(segment) => segment.at(time),
            None => (self.before, time.constant(0.0)),
        }
    }

    /// The same without derivatives.
    #[inline(always)]
    pub fn value_at(&self, time: f64, within: f64) -> (f64, f64) {
        match self.find(within) {
            Some(segment) => segment.values().at(time),
            None => (self.before.value(), 0.0),
        }
    }
}

/// Times at which something reaches the actuator, in order.
#[derive(Debug, Clone)]
pub struct Arrivals<T> {
    queue: VecDeque<(T, Arrival<T>)>,
}

/// What reaches the actuator.
#[derive(Debug, Clone, Copy)]
pub enum Arrival<T> {
    /// A new command.
    Command(T),
    /// A break of the command: 0 a jump, 1 a bend, and so on.
    Break(u8),
}

impl<T: Scalar> Arrivals<T> {
    #[inline(always)]
    pub const fn new() -> Self {
        Self { queue: VecDeque::new() }
    }

    #[inline(always)]
    pub fn push(&mut self, time: T, arrival: Arrival<T>) {
        self.queue.push_back((time, arrival));
    }

    /// When the next one comes.
    #[inline(always)]
    pub fn next(&self) -> Option<T> {
        self.queue.front().map(|(time, _)| *time)
    }

    #[inline(always)]
    pub fn pop(&mut self) -> Option<(T, Arrival<T>)> {
        self.queue.pop_front()
    }
}
