//! Sums of products of a record's residuals and sensitivities, in the pass that simulates the ship.

use crate::cost::measured::{Columns, Measured};
use crate::cost::sums;
use crate::error::{Error, Result};
use crate::stop::Stop;

pub use crate::cost::measured::Sums;

use super::march::{Task, march};
use super::output::Output;
use super::parameters::Parameters;
use super::run::Run;

/// A measured record, and by what its simulation is differentiated.
#[derive(Debug, Clone)]
pub struct Record<'a> {
    run: Run<'a>,
    outputs: Vec<Output>,
    wrt: Vec<usize>,
    measured: Measured<'a>,
}

impl<'a> Record<'a> {
    /// Check and collect; `measured` is `[output, sample]`, `filters` `[output, tap]`, the first tap that of the sample itself.
    ///
    /// A sample that is not finite in any output is masked, and with it those whose filter reaches back to it or to before
    /// the record.
    ///
    /// # Errors
    /// [`Error::Invalid`] for lengths or values that don't fit.
    pub fn new(
        run: Run<'a>,
        outputs: Vec<Output>,
        wrt: Vec<usize>,
        measured: &'a [f64],
        offsets: &'a [f64],
        filters: &'a [f64],
    ) -> Result<Self> {
        let measured = Measured::new(outputs.len(), run.samples(), offsets, measured, filters)?;
        Ok(Self { run, outputs, wrt, measured })
    }

    /// Number of outputs.
    #[must_use]
    pub const fn outputs(&self) -> usize {
        self.outputs.len()
    }

    /// Number of parameters that it is differentiated by.
    #[must_use]
    pub const fn directions(&self) -> usize {
        self.wrt.len()
    }

    /// Roughly how many steps with a derivative the evaluation of a ship takes.
    #[must_use]
    pub fn work(&self, parameters: &Parameters) -> usize {
        Task { parameters: *parameters, outputs: &self.outputs, wrt: &self.wrt }.work(&self.run)
    }

    /// The sums for a ship.
    ///
    /// # Errors
    /// [`Error::Diverged`] where the simulation or the sums leave the finite numbers, [`Error::Stopped`] on request.
    pub fn sums(&self, parameters: &Parameters, stop: &Stop) -> Result<Sums> {
        let task = Task { parameters: *parameters, outputs: &self.outputs, wrt: &self.wrt };
        let mut columns = Columns::new(self.measured, self.wrt.len());
        let mut sums = sums::Sums::new(columns.count());
        march(&task, &self.run, stop, &mut |block| {
            columns.begin(block.from, block.samples);
            for output in 0..self.outputs.len() {
                for direction in 0..self.wrt.len() {
                    columns.slopes(output, direction).copy_from_slice(block.row(output, direction));
                }
                columns.residual(output, block.values(output).iter().copied());
            }
            columns.add_to(&mut sums);
            Ok(())
        })?;
        if !sums.are_finite() {
            let (sample, what) = (self.run.samples() - 1, "the sum of squares");
            return Err(Error::Diverged { sample, time: sample as f64 * self.run.dt, what });
        }
        Ok(columns.combine(&sums))
    }
}
