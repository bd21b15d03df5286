//! Sums of products of a record's residuals and sensitivities: all that a search needs to know of a record, however it weighs.

use super::columns::Columns;
use super::sums::{Combination, Sums};
use crate::error::{Error, Result, require};
use crate::linear::basis::{Basis, Span};
use crate::linear::segmented_pass::{LANES, Layout, STEPS, walk};
use crate::linear::{By, Drive, Output, Parameters, simulate};
use crate::stop::Stop;

/// A measured record, and by what its simulation is differentiated.
#[derive(Debug, Clone)]
pub struct Record<'a> {
    drive: Drive<'a>,
    outputs: Vec<Output>,
    measured: &'a [f64],
    filters: Vec<f64>,
    offsets: Option<Vec<f64>>,
    wrt: Vec<By>,
}

/// Sums over the samples that count of the products of all pairs of columns.
#[derive(Debug, Clone, PartialEq)]
pub struct Products {
    /// For each output its derivatives by `wrt`, what an offset of it adds if there are offsets, and its residual; row after row.
    pub values: Vec<f64>,
    /// Number of columns of an output.
    pub columns: usize,
    /// Number of samples that count.
    pub count: usize,
}

impl<'a> Record<'a> {
    /// Check and collect; `measured` is `[output, sample]`. A sample that is not finite in any output is masked.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a length that does not fit.
    pub fn new(drive: Drive<'a>, outputs: Vec<Output>, measured: &'a [f64], wrt: Vec<By>) -> Result<Self> {
        let (rows, samples) = (outputs.len(), drive.samples());
        require(measured.len() == rows * samples, || {
            format!("measured has {} values, expected {rows} outputs of {samples} samples", measured.len())
        })?;
        Ok(Self { drive, outputs, measured, filters: vec![1.0; rows], offsets: None, wrt })
    }

    /// Filter residuals and sensitivities, by `[output, tap]`, the first tap that of the sample itself.
    ///
    /// With a masked sample all those are masked whose filter reaches back to it, or to before the record.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a length that does not fit, no tap, too many, or one that is not finite.
    pub fn filtered(self, filters: &[f64]) -> Result<Self> {
        require_filters(filters, self.outputs.len(), STEPS)?;
        Ok(Self { filters: filters.to_vec(), ..self })
    }

    /// Take an offset from each output's residuals, and differentiate by it, too.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a length that does not fit, or an offset that is not finite.
    pub fn with_offsets(self, offsets: &[f64]) -> Result<Self> {
        require_numbers("offsets", offsets, self.outputs.len())?;
        Ok(Self { offsets: Some(offsets.to_vec()), ..self })
    }

    /// Steps of one evaluation, each with its derivatives.
    #[must_use]
    pub fn work(&self) -> usize {
        self.drive.samples() * (1 + self.wrt.len())
    }

    /// The sums for one parameter vector.
    ///
    /// # Errors
    /// [`Error::Diverged`] where the simulation or the sums leave the finite numbers, [`Error::Stopped`] on request.
    pub fn products(&self, parameters: &Parameters, stop: &Stop) -> Result<Products> {
        let basis = Basis::new(&self.outputs, &self.wrt);
        let spans: Vec<_> =
            self.outputs.iter().map(|&output| basis.span(output, &self.wrt, parameters)).collect();
        // Seams want whole blocks. And where segments meet, infinity times zero can turn up before the simulation itself leaves
        // the numbers: look again.
        let short = self.drive.samples() < LANES * STEPS;
        for layout in [if short { Layout::Sequential } else { Layout::Segments }, Layout::Sequential] {
            let sums = self.sums(parameters, &basis, &spans, layout, stop)?;
            if sums.are_finite() {
                return Ok(self.combine(&spans, &sums));
            }
        }
        let mut values = vec![0.0; self.measured.len()];
        simulate(parameters, &self.drive, &self.outputs, &[], &mut values, &mut [], stop)?;
        let sample = self.drive.samples() - 1;
        Err(Error::Diverged { sample, time: sample as f64 * self.drive.dt(), what: "the sum of squares" })
    }

    /// Sums of products of the residuals, then of the outputs' columns, then of ones if there are offsets.
    fn sums(
        &self,
        parameters: &Parameters,
        basis: &Basis,
        spans: &[Span],
        layout: Layout,
        stop: &Stop,
    ) -> Result<Sums> {
        let (outputs, samples) = (self.outputs.len(), self.drive.samples());
        let taps = self.filters.len() / outputs;
        let filter = |output: usize| &self.filters[output * taps..][..taps];
        let of_basis = |combination: &[f64], sign: f64| -> Combination {
            let factors = combination.iter().enumerate().filter(|(_, factor)| **factor != 0.0);
            factors.map(|(row, factor)| (outputs + row, sign * factor)).collect()
        };
        let residual = |(row, &output): (usize, &Output)| {
            let mut combination = of_basis(&basis.output(output, parameters), -1.0);
            combination.insert(0, (row, 1.0));
            combination
        };
        let mut rows: Vec<_> = self.outputs.iter().enumerate().map(residual).collect();
        let mut filters: Vec<_> = (0..outputs).map(filter).collect();
        for (output, span) in spans.iter().enumerate() {
            rows.extend(span.columns.iter().map(|column| of_basis(column, 1.0)));
            filters.resize(rows.len(), filter(output));
        }
        // Zero times a sample is zero, or NaN where the sample is missing: so the row shows what was measured.
        rows.push((0..outputs).map(|output| (output, 0.0)).collect());
        filters.push(filter(0));
        let mut sums = Sums::new(rows.len() - usize::from(self.offsets.is_none()));
        let biases: Vec<_> = self.offsets.iter().flatten().map(|offset| -offset).collect();
        let mut columns = Columns::new(&rows, filters, &biases);
        walk(parameters, &self.drive, basis, layout, outputs, stop, |mut block| {
            for (row, measured) in self.measured.chunks_exact(samples).enumerate() {
                block.put(row, measured);
            }
            columns.add(&mut block, &mut sums);
            Ok(())
        })?;
        columns.add_seams(&mut sums);
        Ok(sums)
    }

    fn combine(&self, spans: &[Span], sums: &Sums) -> Products {
        let (outputs, taps) = (self.outputs.len(), self.filters.len() / self.outputs.len());
        let ones = outputs + spans.iter().map(|span| span.columns.len()).sum::<usize>();
        let mut first = outputs;
        let mut all: Vec<Combination> = Vec::new();
        for (output, Span { columns, factors }) in spans.iter().enumerate() {
            all.extend(factors.iter().map(|factors| (first..).zip(factors.iter().copied()).collect()));
            first += columns.len();
            if self.offsets.is_some() {
                all.push(vec![(ones, self.filters[output * taps..][..taps].iter().sum())]);
            }
            all.push(vec![(output, 1.0)]);
        }
        let product = |one: &Combination, other: &Combination| {
            let mut sum = 0.0;
            for &(row, factor) in one.iter().filter(|(_, factor)| *factor != 0.0) {
                for &(column, other_factor) in other {
                    sum += factor * other_factor * sums.product(row, column);
                }
            }
            sum
        };
        let mut values = vec![0.0; all.len() * all.len()];
        for (i, one) in all.iter().enumerate() {
            for (j, other) in all[..=i].iter().enumerate() {
                let sum = product(one, other);
                values[i * all.len() + j] = sum;
                values[j * all.len() + i] = sum;
            }
        }
        Products { values, columns: all.len() / outputs, count: sums.count }
    }
}

/// Refuse another number of values, or values that are not finite.
fn require_numbers(name: &str, values: &[f64], count: usize) -> Result<()> {
    require(values.len() == count && values.iter().all(|value| value.is_finite()), || {
        format!("{name} is {values:?}, expected {count} finite numbers")
    })
}

/// Refuse filters that are not one row of 1 to `most` finite taps for each output.
fn require_filters(filters: &[f64], outputs: usize, most: usize) -> Result<()> {
    let taps = filters.len() / outputs.max(1);
    require(filters.len() == outputs * taps && (1..=most).contains(&taps), || {
        format!("filters has {} values, expected {outputs} rows of 1 to {most}", filters.len())
    })?;
    require(filters.iter().all(|tap| tap.is_finite()), || {
        "filters holds a value that is not finite, expected finite numbers".to_owned()
    })
}
