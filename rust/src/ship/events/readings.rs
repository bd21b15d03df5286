//! Signals read at the samples of the record, each as late as its channel.

use std::collections::VecDeque;

use crate::error::Result;
use crate::scalar::{Scalar, Tangent};
use crate::ship::march::{BLOCK, Block, Consume};
use crate::ship::output::Output;

/// Outputs that are as late as each other.
#[derive(Debug, Clone)]
pub struct Channel<T> {
    /// [s].
    delay: T,
    pub outputs: Vec<usize>,
    /// The sample that is read next.
    next: usize,
}

impl<T: Scalar> Channel<T> {
    fn new(delay: T, outputs: Vec<usize>, dt: f64, samples: usize) -> Self {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // Not negative; saturates.
        let next = ((delay.value() / dt * (1.0 - 1e-12)).ceil() as usize).min(samples);
        Self { delay, outputs, next }
    }

    /// When the signal passes that is read next.
    #[inline(always)]
    fn time(&self, dt: f64) -> T {
        self.delay * -1.0 + self.next as f64 * dt
    }
}

/// All channels, and the rows that are not complete yet.
pub struct Readings<T, const N: usize> {
    pub channels: Vec<Channel<T>>,
    /// For each output what was read and not given away yet.
    queues: Vec<VecDeque<Tangent<N>>>,
    /// For each output how many samples show what was before the record, and that.
    before: Vec<(usize, Tangent<N>)>,
    samples: usize,
    dt: f64,
    block: Block,
    directions: usize,
    /// The sample that is given away next.
    row: usize,
}

impl<T: Scalar, const N: usize> Readings<T, N> {
    /// `delay` tells each output's, `before` each output's value before the record.
    #[inline(always)]
    pub fn new(
        outputs: &[Output],
        delays: [T; 3],
        before: Vec<Tangent<N>>,
        [samples, directions]: [usize; 2],
        dt: f64,
    ) -> Self {
        let kind = |output: &Output| match output {
            Output::Rack | Output::Sum => 0,
            Output::Speed | Output::PropellerSpeed => 1,
            Output::EngineTorque | Output::GaugeTorque => 2,
        };
        let mut channels = Vec::new();
        for (number, delay) in delays.into_iter().enumerate() {
            let of: Vec<_> = (0..outputs.len()).filter(|&place| kind(&outputs[place]) == number).collect();
            if !of.is_empty() {
                channels.push(Channel::new(delay, of, dt, samples));
            }
        }
        let mut first = vec![0; outputs.len()];
        for channel in &channels {
            for &output in &channel.outputs {
                first[output] = channel.next;
            }
        }
        Self {
            channels,
            queues: vec![VecDeque::new(); outputs.len()],
            before: first.into_iter().zip(before).collect(),
            samples,
            dt,
            block: Block::new(outputs.len(), directions),
            directions,
            row: 0,
        }
    }

    /// The channel that reads next, and when; None when all are through.
    #[inline(always)]
    pub fn next(&self) -> Option<(usize, T)> {
        let mut found: Option<(usize, T)> = None;
        for (place, channel) in self.channels.iter().enumerate() {
            if channel.next < self.samples {
                let time = channel.time(self.dt);
                if found.is_none_or(|(_, before)| time.value() < before.value()) {
                    found = Some((place, time));
                }
            }
        }
        found
    }

    /// Take what an output's channel reads now.
    #[inline(always)]
    pub fn push(&mut self, output: usize, number: Tangent<N>) {
        self.queues[output].push_back(number);
    }

    /// A channel has read all its outputs.
    #[inline(always)]
    pub fn advance(&mut self, channel: usize) {
        self.channels[channel].next += 1;
    }

    /// Give away the rows that are complete.
    #[inline(always)]
    pub fn give(&mut self, consume: &mut Consume<'_>) -> Result<()> {
        while self.row < self.samples
            && self
                .before
                .iter()
                .zip(&self.queues)
                .all(|((first, _), queue)| self.row < *first || !queue.is_empty())
        {
            let place = self.row - self.block.from;
            for (output, queue) in self.queues.iter_mut().enumerate() {
                let (first, before) = &self.before[output];
                let number = if self.row < *first { *before } else { queue.pop_front().unwrap_or(*before) };
                for (direction, slope) in number.slopes[..self.directions].iter().enumerate() {
                    self.block.row_mut(output, direction)[place] = *slope;
                }
                self.block.row_mut(output, self.directions)[place] = number.value;
            }
            self.row += 1;
            self.block.samples = place + 1;
            if place + 1 == BLOCK || self.row == self.samples {
                consume(&self.block)?;
                self.block.from = self.row;
                self.block.samples = 0;
            }
        }
        Ok(())
    }
}
