//! Sums that tell what lagged inputs still explain of a fit's residuals, once cleared of what its sensitivities explain.
//!
//! Block by block from the record's end: the inputs' lags and a basis of the sensitivities are laid down while they are in a
//! cache, multiplied with each other and the residuals, run backwards through each output's all-pole filter, and multiplied
//! again.

use crate::cost::columns::Combine;
use crate::cost::sums::{Combination, Sums};
use crate::error::{Error, Result, require};
use crate::filter::all_pole::{AllPole, ORDER};
use crate::instruction_set::arch;
use crate::linear::segmented_pass::BLOCK;
use crate::stop::Stop;

/// Rows whose products make a matrix that still fits into memory.
const MOST_ROWS: usize = 4096;

/// A record after a fit.
#[derive(Debug)]
pub struct Leftover<'a> {
    outputs: usize,
    inputs: usize,
    samples: usize,
    basis: usize,
    /// `[input, reach + sample]`: one input for all outputs, or each output's own.
    set_points: &'a [f64],
    lags: &'a [usize],
    /// `[slope, sample]`.
    slopes: &'a [f64],
    /// `[output, sample]`.
    residuals: &'a [f64],
    /// Each output's basis and residual, combined of slopes and residuals, and what a constant adds.
    combinations: Vec<Combination>,
    biases: Vec<f64>,
    valid: &'a [bool],
    filters: Vec<AllPole>,
}

/// Sums over the samples that count.
#[derive(Debug, Clone, PartialEq)]
pub struct Sum {
    /// `[input, lag, output, basis and residual]`: products of lagged inputs with an output's basis and its residual.
    pub across: Vec<f64>,
    /// `[input, lag]`: of lagged inputs with themselves.
    pub squares: Vec<f64>,
    /// Of all pairs of `[output, lags and basis]` after each output's filter ran backwards.
    pub coloured: Vec<f64>,
}

/// Lengths of what [`Leftover::new`] takes.
#[derive(Debug, Clone, Copy)]
pub struct Shape {
    /// Of the record.
    pub samples: usize,
    /// One, or as many as outputs.
    pub inputs: usize,
    /// Combinations of the slopes, in each output.
    pub basis: usize,
}

impl<'a> Leftover<'a> {
    /// Check and collect. `mix` is `[output, basis, slope]` and what a constant adds last; `models` holds each output's
    /// filter, from the factor of the next sample on.
    ///
    /// # Errors
    /// [`Error::Invalid`](crate::error::Error::Invalid) for a length that does not fit, or a filter that can't be used.
    pub fn new(
        shape: Shape,
        (set_points, lags): (&'a [f64], &'a [usize]),
        (slopes, mix): (&'a [f64], &'a [f64]),
        (residuals, valid): (&'a [f64], &'a [bool]),
        models: &[&[f64]],
    ) -> Result<Self> {
        let Shape { samples, inputs, basis } = shape;
        let outputs = models.len();
        let reach = lags.iter().max().copied().unwrap_or_default();
        let factors = slopes.len() / samples.max(1) + 1;
        require(samples > 0, || "valid has no samples, expected at least 1".to_owned())?;
        let rows = outputs
            .saturating_mul(lags.len().saturating_add(basis + 1))
            .max(inputs.saturating_mul(lags.len()));
        require(rows <= MOST_ROWS, || {
            format!(
                "lags, mix, models: found {rows} rows to multiply with each other, expected up to {MOST_ROWS}"
            )
        })?;
        for (name, found, expected) in [
            ("set_points", set_points.len(), inputs.saturating_mul(reach.saturating_add(samples))),
            ("slopes", slopes.len(), (factors - 1) * samples),
            ("mix", mix.len(), outputs * basis * factors),
            ("residuals", residuals.len(), outputs * samples),
            ("valid", valid.len(), samples),
        ] {
            require(found == expected, || format!("{name} has {found} values, expected {expected}"))?;
        }
        require(inputs == 1 || inputs == outputs, || {
            format!("set_points has {inputs} rows, expected 1 or one for each of {outputs} outputs")
        })?;
        let filters = models.iter().map(|model| AllPole::new(model)).collect::<Result<_>>()?;
        let mut combinations: Vec<Combination> = Vec::new();
        let mut biases = Vec::new();
        for output in 0..outputs {
            for mix in mix[output * basis * factors..][..basis * factors].chunks_exact(factors) {
                let terms = mix[..factors - 1].iter().copied().enumerate();
                combinations.push(terms.filter(|&(_, factor)| factor != 0.0).collect());
                biases.push(mix[factors - 1]);
            }
            combinations.push(vec![(factors - 1 + output, 1.0)]);
            biases.push(0.0);
        }
        Ok(Self {
            outputs,
            inputs,
            samples,
            basis,
            set_points,
            lags,
            slopes,
            residuals,
            combinations,
            biases,
            valid,
            filters,
        })
    }

    /// Add up.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::error::Error::Stopped) on request.
    pub fn sum(&self, stop: &Stop) -> Result<Sum> {
        let (lags, basis) = (self.lags.len(), self.basis);
        let (of_inputs, of_outputs) = (self.inputs * lags, self.outputs * (basis + 1));
        let each = lags + basis;
        let mut across = Sums::across(of_inputs, of_outputs);
        let mut coloured = Sums::new(self.outputs * each);
        let mut squares = vec![0.0; of_inputs];
        let mut inputs = vec![0.0; Sums::space(of_inputs) * BLOCK];
        let mut sources = vec![0.0; (self.slopes.len() + self.residuals.len()) / self.samples * BLOCK];
        let mut outputs = vec![0.0; Sums::space(of_outputs) * BLOCK];
        let mut filtered = vec![0.0; Sums::space(self.outputs * each) * BLOCK];
        let mut after = vec![[0.0; ORDER]; self.outputs * each];
        for first in (0..self.samples).step_by(BLOCK).rev() {
            stop.check()?;
            self.lay_inputs(first, &mut inputs);
            self.lay_outputs(first, &mut sources, &mut outputs);
            across.add_across(&inputs, &outputs);
            for (sum, row) in squares.iter_mut().zip(inputs.chunks_exact(BLOCK)) {
                *sum += square(row);
            }
            for (output, filter) in self.filters.iter().enumerate() {
                let rows = &mut filtered[output * each * BLOCK..][..each * BLOCK];
                let (lagged, combined) = rows.split_at_mut(lags * BLOCK);
                let input = output.min(self.inputs - 1);
                lagged.copy_from_slice(&inputs[input * lagged.len()..][..lagged.len()]);
                combined.copy_from_slice(&outputs[output * (basis + 1) * BLOCK..][..combined.len()]);
                filter.run(rows, &mut after[output * each..][..each]);
            }
            coloured.add(&filtered);
        }
        if !(across.are_finite() && coloured.are_finite()) {
            return Err(Error::Invalid(
                "set_points, slopes, mix, residuals: found a value that is not finite where valid is true, \
                 expected finite numbers"
                    .to_owned(),
            ));
        }
        let pairs =
            |rows: usize, columns: usize| (0..rows * columns).map(move |at| (at / columns, at % columns));
        Ok(Sum {
            across: pairs(of_inputs, of_outputs).map(|(i, j)| across.product_across(i, j)).collect(),
            squares,
            coloured: pairs(self.outputs * each, self.outputs * each)
                .map(|(i, j)| coloured.product(i, j))
                .collect(),
        })
    }

    /// Each input at each lag.
    fn lay_inputs(&self, first: usize, rows: &mut [f64]) {
        let reach = self.lags.iter().max().copied().unwrap_or_default();
        let inputs = self.set_points.chunks_exact(reach + self.samples);
        let lagged = inputs.flat_map(|input| self.lags.iter().map(move |lag| &input[reach - lag..]));
        for (series, row) in lagged.zip(rows.chunks_exact_mut(BLOCK)) {
            self.cut(series, first, row);
        }
        self.mask(first, rows);
    }

    /// Each output's basis, and its residual.
    fn lay_outputs(&self, first: usize, sources: &mut [f64], rows: &mut [f64]) {
        let series = self.slopes.chunks_exact(self.samples).chain(self.residuals.chunks_exact(self.samples));
        for (series, row) in series.zip(sources.chunks_exact_mut(BLOCK)) {
            self.cut(series, first, row);
        }
        arch().dispatch(Combine {
            block: sources,
            combinations: &self.combinations,
            biases: &self.biases,
            into: rows,
            width: BLOCK,
        });
        self.mask(first, rows);
    }

    /// A block of a series.
    fn cut(&self, series: &[f64], first: usize, row: &mut [f64]) {
        let part = &series[first..self.samples.min(first + BLOCK)];
        row[..part.len()].copy_from_slice(part);
    }

    /// Zero where a sample does not count, and beyond the record.
    fn mask(&self, first: usize, rows: &mut [f64]) {
        let valid = &self.valid[first..self.samples.min(first + BLOCK)];
        if valid.len() == BLOCK && valid.iter().fold(true, |all, one| all & one) {
            return;
        }
        for row in rows.chunks_exact_mut(BLOCK) {
            for (value, counts) in row.iter_mut().zip(valid) {
                *value = if *counts { *value } else { 0.0 };
            }
            row[valid.len()..].fill(0.0);
        }
    }
}

fn square(row: &[f64]) -> f64 {
    let mut sums = [0.0; 8];
    for part in row.as_chunks::<8>().0 {
        for (sum, value) in sums.iter_mut().zip(part) {
            *sum += value * value;
        }
    }
    sums.iter().sum()
}
