//! Set point and load between samples: linear or stepwise, with delay.

use crate::hold::Hold;

use super::run::Run;

/// Fraction of a sample below which a difference is rounding.
const TINY: f64 = 1e-9;

/// An input over a step: its values at both ends, as limits from inside the step, and its mean.
#[derive(Debug, Clone, Copy, Default)]
pub struct Span {
    pub start: f64,
    pub end: f64,
    pub mean: f64,
}

/// A sampled input with a delay and, optionally, scale and offset.
#[derive(Debug, Clone, Copy)]
pub struct Input<'a> {
    samples: &'a [f64],
    hold: Hold,
    /// Steps per sample, and samples per step.
    substeps: f64,
    share: f64,
    /// Sample time [s].
    dt: f64,
    /// Delay in samples.
    late: f64,
    /// Value before the first sample.
    before: f64,
    scale: Option<(f64, f64)>,
}

impl<'a> Input<'a> {
    pub fn new(samples: &'a [f64], run: &Run<'_>, delay: f64, scale: Option<(f64, f64)>) -> Self {
        let (substeps, dt) = (run.substeps as f64, run.dt);
        let late = delay / dt;
        // A whole drive train starts at its operating point, with the corresponding input.
        let before = if run.detail.is_some() { 1.0 } else { samples.first().copied().unwrap_or(0.0) };
        Self { samples, hold: run.hold, substeps, share: 1.0 / substeps, dt, late, before, scale }
    }

    /// The input in the first step.
    pub fn first(&self) -> Span {
        let start = self.straight(-self.late);
        self.over(0, start)
    }

    /// The input in the step that starts at instant `at`, counted in steps; `last` is its value at the previous step's end.
    #[inline(always)]
    pub fn over(&self, at: usize, last: f64) -> Span {
        if self.hold == Hold::First {
            let end = self.straight((at + 1) as f64 * self.share - self.late);
            return Span { start: last, end, mean: (last + end) * 0.5 };
        }
        // In a stepwise input, a jump inside the step affects only the step's mean.
        let from = at as f64 * self.share - self.late;
        let (edge, to) = (from.ceil(), from + self.share);
        let (before, after) = (self.sample(edge - 1.0), self.sample(edge));
        let mean = if edge < to {
            let late = (edge - from) * self.substeps;
            self.scaled(after + (before - after) * late)
        } else {
            self.scaled(before)
        };
        Span { start: mean, end: mean, mean }
    }

    /// The input at a time [s].
    #[inline(always)]
    pub fn at(&self, time: f64) -> f64 {
        let place = time / self.dt - self.late;
        match self.hold {
            Hold::First => self.straight(place),
            Hold::Zero => self.scaled(self.sample((place + TINY).floor())),
        }
    }

    #[inline(always)]
    fn straight(&self, place: f64) -> f64 {
        let left = place.ceil() - 1.0;
        let (before, after) = (self.sample(left), self.sample(left + 1.0));
        self.scaled(before + (after - before) * (place - left))
    }

    #[inline(always)]
    fn scaled(&self, value: f64) -> f64 {
        self.scale.map_or(value, |(factor, offset)| offset + value * factor)
    }

    #[inline(always)]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    fn sample(&self, place: f64) -> f64 {
        let last = self.samples.len() - 1;
        if place < 0.0 { self.before } else { self.samples[(place as usize).min(last)] }
    }
}
