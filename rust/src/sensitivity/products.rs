//! Sums of products of a record's residuals and sensitivities, in the pass that simulates it.

use pulp::{Simd, WithSimd};

use crate::cost::sums;
use crate::drive_train::Run;
use crate::error::{Error, Result, require};
use crate::instruction_set::arch;
use crate::linear::segmented_pass::BLOCK;
use crate::scalar::Tangent;
use crate::stop::Stop;

use super::output::Output;
use super::parameters::{MOST, Subject};
use super::pass::march;

/// A measured record: each output is `scale` times the simulated one plus an offset.
#[derive(Debug, Clone)]
pub struct Record<'a> {
    run: Run<'a>,
    outputs: Vec<Output>,
    scale: &'a [f64],
    offsets: &'a [f64],
    /// `[output, sample]`, not a number where masked.
    measured: &'a [f64],
    /// `[output, tap]`, the first tap that of the sample itself.
    filters: &'a [f64],
}

/// Sums over the samples that count of the products of all pairs of columns.
#[derive(Debug, Clone, PartialEq)]
pub struct Sums {
    /// For each output its derivatives by direction, what an offset of it adds, and its residual; row after row.
    pub values: Vec<f64>,
    /// Number of columns of an output.
    pub columns: usize,
    /// Number of samples that count.
    pub count: usize,
}

impl<'a> Record<'a> {
    /// Check and collect.
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
        let (rows, samples) = (outputs.len(), run.set_speed.len());
        require(measured.len() == rows * samples, || {
            format!("measured has {} values, expected {rows} outputs of {samples} samples", measured.len())
        })?;
        for (name, values) in [("scale", scale), ("offsets", offsets)] {
            require(values.len() == rows && values.iter().all(|value| value.is_finite()), || {
                format!("{name} is {values:?}, expected {rows} finite numbers")
            })?;
        }
        let taps = filters.len() / rows.max(1);
        require(filters.len() == rows * taps && (1..=BLOCK).contains(&taps), || {
            format!("filters has {} values, expected {rows} rows of 1 to {BLOCK}", filters.len())
        })?;
        require(filters.iter().all(|tap| tap.is_finite()), || {
            "filters holds a value that is not finite, expected finite numbers".to_owned()
        })?;
        Ok(Self { run, outputs, scale, offsets, measured, filters })
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
        let mut columns = Columns::new(self, subject.directions());
        let mut sums = sums::Sums::new(columns.count());
        march::<N>(subject, &self.run, &self.outputs, BLOCK, stop, &mut |from, rows| {
            columns.lay(from, rows);
            columns.filter();
            sums.count += columns.mask();
            sums.add(&columns.filtered);
            Ok(())
        })?;
        let samples = self.run.set_speed.len();
        if !sums.are_finite() {
            let (sample, what) = (samples - 1, "the sum of squares");
            return Err(Error::Diverged { sample, time: sample as f64 * self.run.dt, what });
        }
        Ok(columns.combine(&sums))
    }
}

/// Columns of a block: for each output its derivatives and its residual, and last of all ones; filtered and masked.
struct Columns<'a> {
    record: &'a Record<'a>,
    directions: usize,
    /// Samples of the past that a filter reaches back to.
    order: usize,
    /// For each column but the last its past, then the block.
    windows: Vec<f64>,
    filtered: Vec<f64>,
    /// Samples of the last block.
    laid: usize,
    /// Samples in a row up to now that were measured.
    unbroken: usize,
    /// Of each sample of the block, whether it counts.
    valid: [bool; BLOCK],
}

impl<'a> Columns<'a> {
    fn new(record: &'a Record<'a>, directions: usize) -> Self {
        let (outputs, order) = (record.outputs.len(), record.filters.len() / record.outputs.len() - 1);
        let columns = outputs * (directions + 1);
        Self {
            record,
            directions,
            order,
            windows: vec![0.0; columns * (order + BLOCK)],
            filtered: vec![0.0; sums::Sums::space(columns + 1) * BLOCK],
            laid: 0,
            unbroken: 0,
            valid: [false; BLOCK],
        }
    }

    fn count(&self) -> usize {
        self.record.outputs.len() * (self.directions + 1) + 1
    }

    /// Lay down a block from a sample on, behind the end of the one before.
    fn lay<const N: usize>(&mut self, from: usize, rows: &[Tangent<N>]) {
        let Self { record, directions, order, .. } = *self;
        let (outputs, samples) = (record.outputs.len(), record.run.set_speed.len());
        let width = order + BLOCK;
        for window in self.windows.chunks_exact_mut(width) {
            window.copy_within(self.laid..self.laid + order, 0);
        }
        self.laid = rows.len() / outputs;
        self.valid.fill(false);
        let mut measured = [true; BLOCK];
        let windows = self.windows.chunks_exact_mut(width * (directions + 1));
        for (output, windows) in windows.enumerate() {
            let (scale, offset) = (record.scale[output], record.offsets[output]);
            let mut columns = windows.chunks_exact_mut(width).map(|window| &mut window[order..]);
            let numbers = || rows[output..].iter().step_by(outputs);
            for (direction, column) in columns.by_ref().take(directions).enumerate() {
                for (value, number) in column.iter_mut().zip(numbers()) {
                    *value = scale * number.slopes[direction];
                }
            }
            let target = &record.measured[output * samples + from..];
            for column in columns {
                for (k, (residual, number)) in column.iter_mut().zip(numbers()).enumerate() {
                    *residual = target[k] - (scale * number.value + offset);
                    measured[k] &= residual.is_finite();
                }
            }
        }
        for (valid, measured) in self.valid.iter_mut().zip(&measured[..rows.len() / outputs]) {
            self.unbroken = if *measured { self.unbroken + 1 } else { 0 };
            *valid = self.unbroken > order;
        }
    }

    fn filter(&mut self) {
        let width = self.order + BLOCK;
        let each = self.windows.chunks_exact(width).zip(self.filtered.chunks_exact_mut(BLOCK));
        for (column, (window, filtered)) in each.enumerate() {
            let output = column / (self.directions + 1);
            let filter = &self.record.filters[output * (self.order + 1)..][..=self.order];
            arch().dispatch(Convolve { window, filter, filtered });
        }
    }

    /// Clear the samples that don't count, and tell how many do.
    fn mask(&mut self) -> usize {
        let (ones, last) = (self.count() - 1, self.count() * BLOCK);
        for k in 0..BLOCK {
            let counts = self.valid[k];
            self.filtered[ones * BLOCK + k] = f64::from(u8::from(counts));
            if !counts {
                for value in self.filtered[k..last].iter_mut().step_by(BLOCK) {
                    *value = 0.0;
                }
            }
        }
        self.valid.iter().filter(|&&valid| valid).count()
    }

    fn combine(&self, sums: &sums::Sums) -> Sums {
        let ones = self.count() - 1;
        let mut all = Vec::new();
        for output in 0..self.record.outputs.len() {
            let first = output * (self.directions + 1);
            let gain: f64 = self.record.filters[output * (self.order + 1)..][..=self.order].iter().sum();
            all.extend((0..self.directions).map(|direction| (first + direction, 1.0)));
            all.extend([(ones, gain), (first + self.directions, 1.0)]);
        }
        let product = |&(row, factor): &(usize, f64), &(column, other): &(usize, f64)| {
            factor * other * sums.product(row, column)
        };
        let values = all.iter().flat_map(|one| all.iter().map(move |other| product(one, other))).collect();
        Sums { values, columns: self.directions + 2, count: sums.count }
    }
}

/// Filter what lies behind the past in a window.
struct Convolve<'a> {
    window: &'a [f64],
    filter: &'a [f64],
    filtered: &'a mut [f64],
}

impl WithSimd for Convolve<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { window, filter, filtered } = self;
        let order = filter.len() - 1;
        filtered.fill(0.0);
        for (lag, tap) in filter.iter().enumerate() {
            for (sum, value) in filtered.iter_mut().zip(&window[order - lag..]) {
                *sum += tap * value;
            }
        }
    }
}
