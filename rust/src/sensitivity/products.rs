//! Sums of products of a record's residuals and sensitivities, in the pass that simulates it.

use crate::cost::measured::{Columns, Measured, require_numbers};
use crate::cost::sums;
use crate::drive_train::Run;
use crate::error::{Error, Result};
use crate::linear::segmented_pass::BLOCK;
use crate::scalar::Tangent;
use crate::stop::Stop;

pub use crate::cost::measured::Sums;

use super::output::Output;
use super::parameters::{MOST, Subject};
use super::pass::march;

/// A measured record: each output is `scale` times the simulated one plus an offset.
#[derive(Debug, Clone)]
pub struct Record<'a> {
    run: Run<'a>,
    outputs: Vec<Output>,
    scale: &'a [f64],
    measured: Measured<'a>,
}

impl<'a> Record<'a> {
    /// Check and collect; `measured` is `[output, sample]`, `filters` `[output, tap]`.
    ///
    /// A sample that is not finite in any output is masked, and with it those whose filter reaches back to it or to
    /// before the record.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a run, lengths or values that don't fit.
    pub fn new(
        run: Run<'a>,
        outputs: Vec<Output>,
        scale: &'a [f64],
        offsets: &'a [f64],
        measured: &'a [f64],
        filters: &'a [f64],
    ) -> Result<Self> {
        run.check()?;
        require_numbers("scale", scale, outputs.len())?;
        let measured = Measured::new(outputs.len(), run.set_speed.len(), offsets, measured, filters)?;
        Ok(Self { run, outputs, scale, measured })
    }

    /// The sums for a subject.
    ///
    /// # Errors
    /// [`Error::Diverged`] where the simulation or the sums leave the finite numbers, [`Error::Stopped`] on request.
    pub fn sums(&self, subject: &Subject, stop: &Stop) -> Result<Sums> {
        match subject.directions() {
            0 => self.sums_of::<0>(subject, stop),
            1..=8 => self.sums_of::<8>(subject, stop),
            9..=16 => self.sums_of::<16>(subject, stop),
            _ => self.sums_of::<MOST>(subject, stop),
        }
    }

    fn sums_of<const N: usize>(&self, subject: &Subject, stop: &Stop) -> Result<Sums> {
        let directions = subject.directions();
        let mut columns = Columns::new(self.measured, directions);
        let mut sums = sums::Sums::new(columns.count());
        march::<N>(subject, &self.run, &self.outputs, BLOCK, stop, &mut |from, rows| {
            self.lay(&mut columns, directions, from, rows);
            columns.add_to(&mut sums);
            Ok(())
        })?;
        let samples = self.run.set_speed.len();
        if !sums.are_finite() {
            let (sample, what) = (samples - 1, "the sum of squares");
            return Err(Error::Diverged { sample, time: sample as f64 * self.run.dt, what });
        }
        Ok(columns.combine(&sums))
    }

    /// Lay down a block from a sample on.
    fn lay<const N: usize>(
        &self,
        columns: &mut Columns<'_>,
        directions: usize,
        from: usize,
        rows: &[Tangent<N>],
    ) {
        let outputs = self.outputs.len();
        columns.begin(from, rows.len() / outputs);
        for (output, &scale) in self.scale.iter().enumerate() {
            let numbers = || rows[output..].iter().step_by(outputs);
            for direction in 0..directions {
                for (slope, number) in columns.slopes(output, direction).iter_mut().zip(numbers()) {
                    *slope = scale * number.slopes[direction];
                }
            }
            columns.residual(output, numbers().map(|number| scale * number.value));
        }
    }
}
