//! Sums of products of pairs of rows, block by block.

use pulp::{Arch, Simd, WithSimd};

use crate::linear::walk::BLOCK;

/// Rows that are multiplied by one row at a time.
const TILE: usize = 4;

/// `sum_k r_i[k] r_j[k]` for all pairs of rows, over the samples where every output was measured.
pub struct Sums {
    rows: usize,
    width: usize,
    products: Vec<f64>,
    /// Number of these samples.
    pub count: usize,
}

/// An output as a combination of the signals' rows.
pub type Combination = Vec<(usize, f64)>;

impl Sums {
    pub fn new(rows: usize) -> Self {
        let width = rows.next_multiple_of(TILE);
        Self { rows, width, products: vec![0.0; rows * width], count: 0 }
    }

    pub fn product(&self, row: usize, column: usize) -> f64 {
        self.products[row.max(column) * self.width + row.min(column)]
    }

    pub fn are_finite(&self) -> bool {
        self.products.iter().all(|sum| sum.is_finite())
    }

    /// Add a block: the measured outputs, not a number where there is none, then the signals, then zeros up to a whole tile.
    /// Its first rows become the residuals.
    pub fn add(&mut self, block: &mut [f64], outputs: &[Combination]) {
        let arch = Arch::new();
        self.count += arch.dispatch(Subtract { block, outputs });
        arch.dispatch(Multiply { block, rows: self.rows, width: self.width, products: &mut self.products });
    }
}

/// Take the simulated outputs from the measured ones, and set all rows to zero where not every output was measured. Gives the
/// number of samples left.
struct Subtract<'a> {
    block: &'a mut [f64],
    outputs: &'a [Combination],
}

impl WithSimd for Subtract<'_> {
    type Output = usize;

    #[inline(always)]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // counts up to BLOCK
    fn with_simd<S: Simd>(self, simd: S) -> usize {
        let vectors = BLOCK / S::F64_LANES;
        let block = S::as_mut_simd_f64s(self.block).0;
        let (zero, one) = (simd.splat_f64s(0.0), simd.splat_f64s(1.0));
        let mut count = zero;
        for at in 0..vectors {
            let mut valid = simd.equal_f64s(zero, zero);
            for output in 0..self.outputs.len() {
                let measured = block[output * vectors + at];
                // Only a finite number less itself is zero.
                valid = simd.and_m64s(valid, simd.equal_f64s(simd.sub_f64s(measured, measured), zero));
                let mut residual = measured;
                for &(signal, factor) in &self.outputs[output] {
                    let signal = block[(self.outputs.len() + signal) * vectors + at];
                    residual = simd.mul_add_e_f64s(simd.splat_f64s(-factor), signal, residual);
                }
                block[output * vectors + at] = residual;
            }
            if simd.first_true_m64s(simd.not_m64s(valid)) < S::F64_LANES {
                for row in (at..block.len()).step_by(vectors) {
                    block[row] = simd.select_f64s(valid, block[row], zero);
                }
            }
            count = simd.add_f64s(count, simd.select_f64s(valid, one, zero));
        }
        simd.reduce_sum_f64s(count) as usize
    }
}

/// Add up a block's products: each row with `TILE` rows at a time up to itself.
struct Multiply<'a> {
    block: &'a [f64],
    rows: usize,
    width: usize,
    products: &'a mut [f64],
}

impl WithSimd for Multiply<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let vectors = BLOCK / S::F64_LANES;
        let block = S::as_simd_f64s(self.block).0;
        for row in 0..self.rows {
            let one = &block[row * vectors..][..vectors];
            for first in (0..=row).step_by(TILE) {
                let others = &block[first * vectors..][..TILE * vectors];
                let mut sums = [simd.splat_f64s(0.0); TILE];
                for at in 0..vectors {
                    for column in 0..TILE {
                        sums[column] =
                            simd.mul_add_e_f64s(one[at], others[column * vectors + at], sums[column]);
                    }
                }
                let products = &mut self.products[row * self.width + first..];
                for (product, sum) in products.iter_mut().zip(sums) {
                    *product += simd.reduce_sum_f64s(sum);
                }
            }
        }
    }
}
