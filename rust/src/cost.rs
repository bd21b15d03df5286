//! Cost, gradient and Gauss-Newton matrix of the linear structure, one pass over the samples.
//!
//! The pass does not form the sensitivities of the outputs. It sums the products of all pairs of rows: the residuals, the
//! signals that outputs are made of and these signals' derivatives in the few directions the loop depends on. Cost, gradient,
//! Gauss-Newton matrix and scatter are then small combinations of these sums, so many parameters cost no more than few.

mod sums;

use rayon::prelude::*;

use crate::error::{Error, Result, require};
use crate::linear::basis::Basis;
use crate::linear::walk::{Layout, walk};
use crate::linear::{By, Drive, Output, Parameters, simulate};
use crate::pool::on_threads;
use crate::stop::Stop;
use sums::{Combination, Sums};

/// What a parameter vector is judged by: `sum_k e_k' W e_k` with `e` measured less simulated, over the samples where every
/// measured output is finite.
#[derive(Debug, Clone)]
pub struct Objective<'a> {
    drive: Drive<'a>,
    outputs: Vec<Output>,
    measured: &'a [f64],
    weight: &'a [f64],
    wrt: Vec<By>,
}

/// An [`Objective`]'s value; matrices row after row.
#[derive(Debug, Clone, PartialEq)]
pub struct Cost {
    /// Weighted sum of squares.
    pub cost: f64,
    /// Its derivatives by `wrt`.
    pub gradient: Vec<f64>,
    /// `2 sum_k S_k' W S_k`, its second derivatives where residuals are small.
    pub gauss_newton: Vec<f64>,
    /// `sum_k e_k e_k'`.
    pub scatter: Vec<f64>,
    /// Number of samples that count.
    pub count: usize,
}

impl<'a> Objective<'a> {
    /// Check and collect; `measured` is `[output, sample]`, `weight` `[output, output]`.
    ///
    /// # Errors
    /// [`Error::Invalid`] for lengths that don't fit or a weight that is not symmetric and finite.
    pub fn new(
        drive: Drive<'a>,
        outputs: Vec<Output>,
        measured: &'a [f64],
        weight: &'a [f64],
        wrt: Vec<By>,
    ) -> Result<Self> {
        let (rows, samples) = (outputs.len(), drive.samples());
        require(measured.len() == rows * samples, || {
            format!("measured has {} values, expected {rows} outputs of {samples} samples", measured.len())
        })?;
        require(weight.len() == rows * rows, || {
            format!("weight has {} values, expected {rows} rows of {rows}", weight.len())
        })?;
        for i in 0..rows {
            for j in 0..=i {
                let (one, other) = (weight[i * rows + j], weight[j * rows + i]);
                require(one.is_finite() && (one - other).abs() <= 1e-12 * (one.abs() + other.abs()), || {
                    format!(
                        "weight[{i}, {j}] is {one} and weight[{j}, {i}] {other}, expected a finite symmetric matrix"
                    )
                })?;
            }
        }
        Ok(Self { drive, outputs, measured, weight, wrt })
    }

    /// Steps of one evaluation, each with its derivatives.
    #[must_use]
    pub fn work(&self) -> usize {
        self.drive.samples() * (1 + self.wrt.len())
    }

    /// The cost of one parameter vector.
    ///
    /// # Errors
    /// [`Error::Invalid`] where no sample has every output, [`Error::Diverged`] where the simulation or the sums leave the finite
    /// numbers, [`Error::Stopped`] on request.
    pub fn evaluate(&self, parameters: &Parameters, stop: &Stop) -> Result<Cost> {
        let basis = Basis::new(&self.outputs, &self.wrt);
        // Where segments meet, infinity times zero can turn up before the simulation itself leaves the numbers: look again.
        for layout in [Layout::Segments, Layout::Sequential] {
            let sums = self.sums(parameters, &basis, layout, stop)?;
            require(sums.count > 0, || {
                "measured has no sample where every output is finite, expected at least 1".to_owned()
            })?;
            if sums.are_finite() {
                return Ok(self.combine(parameters, &basis, &sums));
            }
        }
        let mut values = vec![0.0; self.measured.len()];
        simulate(parameters, &self.drive, &self.outputs, &[], &mut values, &mut [], stop)?;
        let sample = self.drive.samples() - 1;
        Err(Error::Diverged { sample, time: sample as f64 * self.drive.dt(), what: "the sum of squares" })
    }

    /// The costs of many parameter vectors on so many threads, 0 for all cores; the same bits for any number.
    ///
    /// A vector whose simulation diverges costs infinity, and its derivatives are not numbers.
    ///
    /// # Errors
    /// [`Error::Invalid`] where no sample has every output, [`Error::Stopped`] on request, [`Error::Internal`] where the system
    /// gives no threads.
    pub fn evaluate_batch(
        &self,
        parameters: &[Parameters],
        threads: usize,
        stop: &Stop,
    ) -> Result<Vec<Cost>> {
        let one = |parameters| match self.evaluate(parameters, stop) {
            Err(Error::Diverged { .. }) => Ok(self.infinite()),
            outcome => outcome,
        };
        if threads == 1 {
            return parameters.iter().map(one).collect();
        }
        on_threads(threads, || parameters.par_iter().map(one).collect())
    }

    fn infinite(&self) -> Cost {
        let (rows, columns) = (self.outputs.len(), self.wrt.len());
        Cost {
            cost: f64::INFINITY,
            gradient: vec![f64::NAN; columns],
            gauss_newton: vec![f64::NAN; columns * columns],
            scatter: vec![f64::NAN; rows * rows],
            count: 0,
        }
    }

    /// Sums of products: of the residuals, followed by the basis' rows where derivatives are wanted.
    fn sums(&self, parameters: &Parameters, basis: &Basis, layout: Layout, stop: &Stop) -> Result<Sums> {
        let (rows, samples) = (self.outputs.len(), self.drive.samples());
        let combinations: Vec<Combination> = self
            .outputs
            .iter()
            .map(|&output| {
                basis
                    .output(output, parameters)
                    .into_iter()
                    .enumerate()
                    .filter(|(_, factor)| *factor != 0.0)
                    .collect()
            })
            .collect();
        let mut sums = Sums::new(if self.wrt.is_empty() { rows } else { rows + basis.rows() });
        walk(parameters, &self.drive, basis, layout, rows, stop, |mut block| {
            for (row, measured) in self.measured.chunks_exact(samples).enumerate() {
                block.put(row, measured);
            }
            sums.add(block.rows(), &combinations);
            Ok(())
        })?;
        Ok(sums)
    }

    fn combine(&self, parameters: &Parameters, basis: &Basis, sums: &Sums) -> Cost {
        let (rows, columns) = (self.outputs.len(), self.wrt.len());
        let scatter: Vec<_> = (0..rows * rows).map(|at| sums.product(at / rows, at % rows)).collect();
        let cost = scatter.iter().zip(self.weight).map(|(product, weight)| product * weight).sum();
        // Each output's sensitivity as a combination of the basis' rows, by parameter.
        let sensitivities: Vec<Vec<Vec<f64>>> = self
            .wrt
            .iter()
            .map(|&by| self.outputs.iter().map(|&output| basis.sensitivity(output, by, parameters)).collect())
            .collect();
        // The sum over samples of a residual or a row of the basis times the sensitivity `combination`.
        let against = |row: usize, combination: &[f64]| -> f64 {
            combination.iter().enumerate().map(|(i, factor)| factor * sums.product(row, rows + i)).sum()
        };
        let weighted = |products: &dyn Fn(usize, usize) -> f64| -> f64 {
            (0..rows * rows).map(|at| self.weight[at] * products(at / rows, at % rows)).sum()
        };
        let gradient = sensitivities.iter().map(|by| -2.0 * weighted(&|i, j| against(i, &by[j]))).collect();
        let mut gauss_newton = vec![0.0; columns * columns];
        for one in 0..columns {
            for other in 0..=one {
                let sum = 2.0
                    * weighted(&|i, j| {
                        let factors = sensitivities[one][i].iter().enumerate();
                        factors
                            .filter(|(_, factor)| **factor != 0.0)
                            .map(|(row, factor)| factor * against(rows + row, &sensitivities[other][j]))
                            .sum()
                    });
                gauss_newton[one * columns + other] = sum;
                gauss_newton[other * columns + one] = sum;
            }
        }
        Cost { cost, gradient, gauss_newton, scatter, count: sums.count }
    }
}
