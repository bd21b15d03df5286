//! A measured record against a simulation that comes block by block: residuals and sensitivities, filtered, masked, multiplied.

use multiversion::multiversion;

use super::sums;
use crate::error::{Result, require};
use crate::linear::segmented_pass::BLOCK;

/// What was measured, and how residuals are filtered.
#[derive(Debug, Clone, Copy)]
#[allow(clippy::struct_field_names)] // The measured values are the record's main part.
pub struct Measured<'a> {
    outputs: usize,
    samples: usize,
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

impl<'a> Measured<'a> {
    /// Check and collect.
    ///
    /// A sample that is not finite in any output is masked, and with it those whose filter reaches back to it or to
    /// before the record.
    ///
    /// # Errors
    /// [`Error::Invalid`](crate::error::Error::Invalid) for lengths or values that don't fit.
    pub fn new(
        outputs: usize,
        samples: usize,
        offsets: &'a [f64],
        measured: &'a [f64],
        filters: &'a [f64],
    ) -> Result<Self> {
        require(measured.len() == outputs * samples, || {
            format!("measured has {} values, expected {outputs} outputs of {samples} samples", measured.len())
        })?;
        require_numbers("offsets", offsets, outputs)?;
        require_filters(filters, outputs, BLOCK)?;
        Ok(Self { outputs, samples, offsets, measured, filters })
    }

    const fn order(&self) -> usize {
        self.filters.len() / self.outputs - 1
    }

    fn filter(&self, output: usize) -> &'a [f64] {
        &self.filters[output * (self.order() + 1)..][..=self.order()]
    }
}

/// Refuse another number of values, or values that are not finite.
pub fn require_numbers(name: &str, values: &[f64], count: usize) -> Result<()> {
    require(values.len() == count && values.iter().all(|value| value.is_finite()), || {
        format!("{name} is {values:?}, expected {count} finite numbers")
    })
}

/// Refuse filters that are not one row of 1 to `most` finite taps for each output.
pub fn require_filters(filters: &[f64], outputs: usize, most: usize) -> Result<()> {
    let taps = filters.len() / outputs.max(1);
    require(filters.len() == outputs * taps && (1..=most).contains(&taps), || {
        format!("filters has {} values, expected {outputs} rows of 1 to {most}", filters.len())
    })?;
    require(filters.iter().all(|tap| tap.is_finite()), || {
        "filters holds a value that is not finite, expected finite numbers".to_owned()
    })
}

/// Columns of a block: for each output its derivatives and its residual, and last of all ones; filtered and masked.
pub struct Columns<'a> {
    of: Measured<'a>,
    directions: usize,
    /// Samples of the past that a filter reaches back to.
    order: usize,
    /// For each column but the last its past, then the block.
    windows: Vec<f64>,
    filtered: Vec<f64>,
    /// The block's first sample, and how many it has.
    from: usize,
    laid: usize,
    /// Samples in a row up to now that were measured.
    unbroken: usize,
    /// Of each sample of the block, whether all outputs were measured there, and whether it counts.
    present: [bool; BLOCK],
    valid: [bool; BLOCK],
}

impl<'a> Columns<'a> {
    pub fn new(of: Measured<'a>, directions: usize) -> Self {
        let order = of.order();
        let columns = of.outputs * (directions + 1);
        Self {
            of,
            directions,
            order,
            windows: vec![0.0; columns * (order + BLOCK)],
            filtered: vec![0.0; sums::Sums::space(columns + 1) * BLOCK],
            from: 0,
            laid: 0,
            unbroken: 0,
            present: [false; BLOCK],
            valid: [false; BLOCK],
        }
    }

    /// Number of columns, that of ones among them.
    pub const fn count(&self) -> usize {
        self.of.outputs * (self.directions + 1) + 1
    }

    /// Make room for a block of so many samples from one on, behind the end of the one before.
    pub fn begin(&mut self, from: usize, samples: usize) {
        let width = self.order + BLOCK;
        for window in self.windows.chunks_exact_mut(width) {
            window.copy_within(self.laid..self.laid + self.order, 0);
        }
        (self.from, self.laid) = (from, samples);
        self.present = [true; BLOCK];
    }

    /// The column for an output's derivatives in a direction.
    pub fn slopes(&mut self, output: usize, direction: usize) -> &mut [f64] {
        let column = output * (self.directions + 1) + direction;
        &mut self.windows[column * (self.order + BLOCK) + self.order..][..self.laid]
    }

    /// Write an output's residual from its simulated values.
    pub fn residual(&mut self, output: usize, values: impl Iterator<Item = f64>) {
        let Measured { samples, offsets, measured, .. } = self.of;
        let column = output * (self.directions + 1) + self.directions;
        let residuals = &mut self.windows[column * (self.order + BLOCK) + self.order..][..self.laid];
        let target = &measured[output * samples + self.from..][..self.laid];
        for (((residual, target), value), present) in
            residuals.iter_mut().zip(target).zip(values).zip(&mut self.present)
        {
            *residual = target - (value + offsets[output]);
            *present &= residual.is_finite();
        }
    }

    /// Filter and mask the block, and add up its products.
    pub fn add_to(&mut self, sums: &mut sums::Sums) {
        let (order, laid) = (self.order, self.laid);
        self.valid.fill(false);
        for (valid, present) in self.valid.iter_mut().zip(&self.present[..laid]) {
            self.unbroken = if *present { self.unbroken + 1 } else { 0 };
            *valid = self.unbroken > order;
        }
        let each = self.windows.chunks_exact(order + BLOCK).zip(self.filtered.chunks_exact_mut(BLOCK));
        for (column, (window, filtered)) in each.enumerate() {
            convolve(window, self.of.filter(column / (self.directions + 1)), filtered);
        }
        sums.count += self.mask();
        sums.add(&self.filtered);
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

    /// The sums of products of all pairs of columns, those that offsets add among them.
    pub fn combine(&self, sums: &sums::Sums) -> Sums {
        let ones = self.count() - 1;
        let mut all = Vec::new();
        for output in 0..self.of.outputs {
            let first = output * (self.directions + 1);
            let gain: f64 = self.of.filter(output).iter().sum();
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
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
fn convolve(window: &[f64], filter: &[f64], filtered: &mut [f64]) {
    let order = filter.len() - 1;
    filtered.fill(0.0);
    for (lag, tap) in filter.iter().enumerate() {
        for (sum, value) in filtered.iter_mut().zip(&window[order - lag..]) {
            *sum += tap * value;
        }
    }
}
