//! Sums of products of pairs of rows, block by block.

use pulp::{Simd, WithSimd};

use crate::instruction_set::arch;
use crate::linear::segmented_pass::BLOCK;

/// Rows that are multiplied by a pair of rows at a time: more products than loads, and enough to hide their latency.
const TILE: usize = 4;
const PAIR: usize = 2;
/// Lanes of the widest vectors.
const WIDEST: usize = 8;

/// `sum_k r_i[k] r_j[k]` for all pairs of rows, or of rows and others, over the samples where every output was measured.
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

    /// Sums for the products of each row with each of so many other rows.
    pub fn across(rows: usize, others: usize) -> Self {
        let width = Self::space(others);
        Self { rows, width, products: vec![0.0; rows * width], count: 0 }
    }

    /// The sum of products of a row and one of the other rows.
    pub fn product_across(&self, row: usize, other: usize) -> f64 {
        self.products[row * self.width + other]
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

    /// Add the products of a block's rows with each other; the block has the size that [`Self::space`] says.
    pub fn add(&mut self, block: &[f64]) {
        let (rows, width, all) = (self.rows, self.width, false);
        arch().dispatch(Multiply { block, others: block, rows, width, all, products: &mut self.products });
    }

    /// Add the products of the rows of one block with those of another, both of the size that [`Self::space`] says.
    pub fn add_across(&mut self, block: &[f64], others: &[f64]) {
        let (rows, width, all) = (self.rows, self.width, true);
        arch().dispatch(Multiply { block, others, rows, width, all, products: &mut self.products });
    }
}

/// Add up a block's products: each pair of rows with `TILE` others at a time, all of them or up to themselves.
struct Multiply<'a> {
    block: &'a [f64],
    others: &'a [f64],
    all: bool,
    rows: usize,
    width: usize,
    products: &'a mut [f64],
}

impl WithSimd for Multiply<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match WIDEST / S::F64_LANES {
            1 => self.in_parts::<S, 1>(simd),
            2 => self.in_parts::<S, 2>(simd),
            4 => self.in_parts::<S, 4>(simd),
            _ => self.in_parts::<S, WIDEST>(simd),
        }
    }
}

impl Multiply<'_> {
    /// Sums of every `WIDEST`-th product, in so many parts of vectors; these are then added by halves. So the widest and the
    /// narrowest vectors add the same numbers in the same order, and give the same bits where both fuse multiply-adds.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // an iterator that is not inlined would not be compiled for the machine's vectors
    fn in_parts<S: Simd, const PARTS: usize>(self, simd: S) {
        let vectors = BLOCK / S::F64_LANES;
        let (block, rest) = (S::as_simd_f64s(self.block).0, S::as_simd_f64s(self.others).0);
        for row in (0..self.rows).step_by(PAIR) {
            let pair = &block[row * vectors..][..PAIR * vectors];
            for first in (0..if self.all { self.width } else { row + 1 }).step_by(TILE) {
                let others = &rest[first * vectors..][..TILE * vectors];
                let zero = simd.splat_f64s(0.0);
                let mut parts = [[[zero; TILE]; PAIR]; PARTS];
                for part in 0..PARTS {
                    let mut sums = [[zero; TILE]; PAIR];
                    for step in 0..vectors / PARTS {
                        let at = step * PARTS + part;
                        for one in 0..PAIR {
                            for column in 0..TILE {
                                sums[one][column] = simd.mul_add_e_f64s(
                                    pair[one * vectors + at],
                                    others[column * vectors + at],
                                    sums[one][column],
                                );
                            }
                        }
                    }
                    parts[part] = sums;
                }
                for one in 0..PAIR.min(self.rows - row) {
                    let products = &mut self.products[(row + one) * self.width + first..];
                    for column in 0..TILE {
                        let mut half = PARTS / 2;
                        while half > 0 {
                            for part in 0..half {
                                parts[part][one][column] =
                                    simd.add_f64s(parts[part][one][column], parts[part + half][one][column]);
                            }
                            half /= 2;
                        }
                        products[column] += simd.reduce_sum_f64s(parts[0][one][column]);
                    }
                }
            }
        }
    }
}
