//! Cost, gradient and Gauss-Newton matrix of the linear structure, one pass over the samples.
//!
//! The pass does not form the sensitivities of the outputs. It sums the products of all pairs of rows: the residuals, and the
//! signals that outputs are made of and their derivatives in the few directions the loop depends on. Cost, gradient,
//! Gauss-Newton matrix and scatter are then small combinations of these sums, so many parameters cost no more than few.

mod batch;
pub(crate) mod columns;
mod many_vectors;
pub(crate) mod measured;
mod products;
pub(crate) mod sums;

use crate::error::{Result, require};
use crate::linear::{By, Drive, Output, Parameters};
use crate::stop::Stop;
pub use products::{Products, Record};

/// What a parameter vector is judged by: `sum_k e_k' W e_k` with `e` measured less simulated, over the samples where every
/// measured output is finite.
#[derive(Debug, Clone)]
pub struct Objective<'a> {
    record: Record<'a>,
    weight: &'a [f64],
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
        let rows = outputs.len();
        let record = Record::new(drive, outputs, measured, wrt)?;
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
        Ok(Self { record, weight })
    }

    /// Steps of one evaluation, each with its derivatives.
    #[must_use]
    pub fn work(&self) -> usize {
        self.record.work()
    }

    /// The cost of one parameter vector.
    ///
    /// # Errors
    /// [`Error::Invalid`] where no sample has every output, [`Error::Diverged`] where the simulation or the sums leave the finite
    /// numbers, [`Error::Stopped`] on request.
    pub fn evaluate(&self, parameters: &Parameters, stop: &Stop) -> Result<Cost> {
        let products = self.record.products(parameters, stop)?;
        require(products.count > 0, || {
            "measured has no sample where every output is finite, expected at least 1".to_owned()
        })?;
        Ok(self.weigh(&products))
    }

    fn infinite(&self) -> Cost {
        let (rows, columns) = (self.record.outputs.len(), self.record.wrt.len());
        Cost {
            cost: f64::INFINITY,
            gradient: vec![f64::NAN; columns],
            gauss_newton: vec![f64::NAN; columns * columns],
            scatter: vec![f64::NAN; rows * rows],
            count: 0,
        }
    }

    fn weigh(&self, products: &Products) -> Cost {
        let (rows, columns) = (self.record.outputs.len(), self.record.wrt.len());
        let residual = columns;
        let weighted = |a: usize, b: usize| -> f64 {
            let pairs = (0..rows * rows).map(|at| [at / rows, at % rows]);
            pairs.zip(self.weight).map(|([i, j], weight)| weight * products.of([i, a], [j, b], rows)).sum()
        };
        let pairs = (0..columns * columns).map(|at| (at / columns, at % columns));
        Cost {
            cost: weighted(residual, residual),
            gradient: (0..columns).map(|by| -2.0 * weighted(by, residual)).collect(),
            gauss_newton: pairs.map(|(a, b)| 2.0 * weighted(a.max(b), a.min(b))).collect(),
            scatter: (0..rows * rows)
                .map(|at| products.of([at / rows, residual], [at % rows, residual], rows))
                .collect(),
            count: products.count,
        }
    }
}
