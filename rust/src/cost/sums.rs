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

/// Rows and their factors.
pub type Combination = Vec<(usize, f64)>;

impl Sums {
    pub fn new(rows: usize) -> Self {
        let width = Self::space(rows);
        Self { rows, width, products: vec![0.0; rows * width], count: 0 }
    }

    pub fn product(&self, row: usize, column: usize) -> f64 {
        self.products[row.max(column) * self.width + row.min(column)]
    }

    pub fn are_finite(&self) -> bool {
        self.products.iter().all(|sum| sum.is_finite())
    }

    /// Rows that a block of so many needs: zeros up to a whole tile.
    pub fn space(rows: usize) -> usize {
        rows.next_multiple_of(TILE)
    }

    /// Add a block of as many rows as [`Self::space`] says.
    pub fn add(&mut self, block: &[f64]) {
        let (rows, width) = (self.rows, self.width);
        Arch::new().dispatch(Multiply { block, rows, width, products: &mut self.products });
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
