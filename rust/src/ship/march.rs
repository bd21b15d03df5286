//! A simulation as a march through a record: outputs and their derivatives in blocks of samples.

use crate::error::{Error, Result};
use crate::finite::all_finite;
pub use crate::linear::segmented_pass::BLOCK;
use crate::stop::Stop;

use super::output::{OUTPUTS, Output};
use super::parameters::{Parameters, Path};
use super::run::Run;
use super::{events, smooth};

/// What is simulated, and by what it is differentiated.
#[derive(Debug, Clone, Copy)]
pub struct Task<'a> {
    /// The ship.
    pub parameters: Parameters,
    /// Signals wanted.
    pub outputs: &'a [Output],
    /// Places of parameters.
    pub wrt: &'a [usize],
}

impl Task<'_> {
    /// Which integration is taken.
    fn path(&self, run: &Run<'_>) -> Path {
        match self.parameters.path() {
            Path::Events if smooth::is_limited(&self.parameters, self.wrt, run) => Path::Limited,
            path => path,
        }
    }

    /// Roughly how many steps with a derivative a simulation takes.
    #[must_use]
    pub fn work(&self, run: &Run<'_>) -> usize {
        let steps = match self.path(run) {
            Path::Smooth => smooth::work(self, run),
            Path::Limited => 2 * smooth::work(self, run),
            Path::Events => events::work(self, run),
        };
        steps.saturating_mul(1 + self.wrt.len())
    }
}

/// A block of samples, at most [`BLOCK`] of them: rows of [`BLOCK`] values, for each output its derivatives and then its value.
#[derive(Debug)]
pub struct Block {
    /// The first sample.
    pub from: usize,
    /// How many there are.
    pub samples: usize,
    columns: usize,
    rows: Vec<f64>,
}

impl Block {
    /// An empty one.
    #[must_use]
    pub fn new(outputs: usize, directions: usize) -> Self {
        let columns = directions + 1;
        Self { from: 0, samples: 0, columns, rows: vec![0.0; outputs * columns * BLOCK] }
    }

    /// An output's derivative by the parameter of that place in `wrt`; its values where that is the number of parameters.
    #[must_use]
    pub fn row(&self, output: usize, column: usize) -> &[f64] {
        &self.rows[(output * self.columns + column) * BLOCK..][..self.samples]
    }

    /// The same, all [`BLOCK`] of it, to be written.
    pub fn row_mut(&mut self, output: usize, column: usize) -> &mut [f64] {
        &mut self.rows[(output * self.columns + column) * BLOCK..][..BLOCK]
    }

    /// So many rows of an output from one on, one after the other.
    pub fn rows_of(&mut self, output: usize, column: usize, count: usize) -> &mut [f64] {
        &mut self.rows[(output * self.columns + column) * BLOCK..][..count * BLOCK]
    }

    /// An output's values.
    #[must_use]
    pub fn values(&self, output: usize) -> &[f64] {
        self.row(output, self.columns - 1)
    }

    /// Refuse what is not finite.
    fn require_finite(&self, outputs: &[Output], dt: f64) -> Result<()> {
        let rows = || self.rows.chunks_exact(BLOCK).map(|row| &row[..self.samples]);
        if rows().all(all_finite) {
            return Ok(());
        }
        let first = |(at, row): (usize, &[f64])| {
            let sample = row.iter().position(|value| !value.is_finite())?;
            let value = at % self.columns == self.columns - 1;
            // A value that leaves the numbers takes its derivatives along.
            Some((
                sample,
                !value,
                if value { OUTPUTS[outputs[at / self.columns] as usize] } else { "a sensitivity" },
            ))
        };
        let Some((sample, _, what)) = rows().enumerate().filter_map(first).min() else { return Ok(()) };
        let sample = self.from + sample;
        Err(Error::Diverged { sample, time: sample as f64 * dt, what })
    }
}

/// What takes the blocks, one after the other.
pub type Consume<'a> = dyn FnMut(&Block) -> Result<()> + 'a;

/// Simulate, and give every block of samples to `consume`.
///
/// # Errors
/// [`Error::Invalid`] for what can't be differentiated by, [`Error::Diverged`] where a row is not finite, [`Error::Stopped`] on
/// request, and what `consume` returns.
pub fn march(task: &Task<'_>, run: &Run<'_>, stop: &Stop, consume: &mut Consume<'_>) -> Result<()> {
    task.parameters.check_wrt(task.wrt)?;
    let mut checked = |block: &Block| {
        block.require_finite(task.outputs, run.dt)?;
        consume(block)
    };
    match task.path(run) {
        Path::Smooth => smooth::march(task, run, stop, &mut checked),
        Path::Limited => smooth::march_limited(task, run, stop, &mut checked),
        Path::Events => events::march(task, run, stop, &mut checked),
    }
}
