//! Signals read at the samples of the record, each as late as its channel.

use std::collections::VecDeque;

use crate::error::Result;
use crate::scalar::{Scalar, Tangent};
use crate::ship::march::{BLOCK, Block, Consume};
use crate::ship::output::Output;

/// Samples that go into the block together.
const STAGE: usize = 8;

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
    /// Whether all outputs are read at their samples.
    at_once: bool,
    /// The last few samples of each row: rows lie so far apart that single values would push each other out of the cache.
    stage: Vec<[f64; STAGE]>,
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
        let mut channels: Vec<Channel<T>> = Vec::new();
        for (number, delay) in delays.into_iter().enumerate() {
            let of: Vec<_> = (0..outputs.len()).filter(|&place| kind(&outputs[place]) == number).collect();
            let same = |channel: &&mut Channel<T>| {
                channel.delay == delay && channel.delay.is_constant() && delay.is_constant()
            };
            if let Some(channel) = channels.iter_mut().find(same) {
                channel.outputs.extend(of);
            } else if !of.is_empty() {
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
            queues: vec![VecDeque::new(); outputs.len()],
            before: first.into_iter().zip(before).collect(),
            at_once: channels.len() == 1 && channels[0].next == 0,
            channels,
            stage: vec![[0.0; STAGE]; outputs.len() * (directions + 1)],
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
        if self.at_once {
            self.lay(output, &number);
        } else {
            self.queues[output].push_back(number);
        }
    }

    /// An output at the sample that is given away next.
    #[inline(always)]
    fn lay(&mut self, output: usize, number: &Tangent<N>) {
        let place = (self.row - self.block.from) % STAGE;
        let rows = &mut self.stage[output * (self.directions + 1)..][..=self.directions];
        rows[self.directions][place] = number.value;
        for (row, slope) in rows.iter_mut().zip(&number.slopes[..self.directions]) {
            row[place] = *slope;
        }
    }

    /// A channel has read all its outputs.
    #[inline(always)]
    pub fn advance(&mut self, channel: usize) {
        self.channels[channel].next += 1;
    }

    /// Give away the rows that are complete.
    #[inline(always)]
    pub fn give(&mut self, consume: &mut Consume<'_>) -> Result<()> {
        if self.at_once {
            return if self.row < self.channels[0].next { self.give_row(consume) } else { Ok(()) };
        }
        while self.row < self.samples
            && self
                .before
                .iter()
                .zip(&self.queues)
                .all(|((first, _), queue)| self.row < *first || !queue.is_empty())
        {
            for output in 0..self.queues.len() {
                let (first, before) = self.before[output];
                let read = if self.row < first { None } else { self.queues[output].pop_front() };
                self.lay(output, &read.unwrap_or(before));
            }
            self.give_row(consume)?;
        }
        Ok(())
    }

    /// Give away the row that was laid.
    #[inline(always)]
    fn give_row(&mut self, consume: &mut Consume<'_>) -> Result<()> {
        self.row += 1;
        let filled = self.row - self.block.from;
        self.block.samples = filled;
        let full = filled == BLOCK || self.row == self.samples;
        if full || filled.is_multiple_of(STAGE) {
            let from = (filled - 1) / STAGE * STAGE;
            let outputs = self.queues.len();
            for output in 0..outputs {
                for column in 0..=self.directions {
                    let stage = &self.stage[output * (self.directions + 1) + column];
                    self.block.row_mut(output, column)[from..filled].copy_from_slice(&stage[..filled - from]);
                }
            }
        }
        if full {
            consume(&self.block)?;
            self.block.from = self.row;
            self.block.samples = 0;
        }
        Ok(())
    }
}
