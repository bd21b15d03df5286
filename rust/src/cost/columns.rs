//! Rows whose products are summed: residuals, columns of their sensitivities, and ones where a sample counts, all of them filtered.
//!
//! To filter the model's outputs and to put filtered inputs into the model is the same, but for the start of the record. So
//! the sensitivities are filtered block by block, while a block is in the fastest cache, and never the record as a whole.

use pulp::{Simd, WithSimd};

use super::sums::{Combination, Sums};
use crate::instruction_set::arch;
use crate::linear::segmented_pass::{BLOCK, Block, LANES, STEPS};

/// Vectors that are filtered side by side.
const ABREAST: usize = 8;

/// Rows of a block, each combined of the pass' rows, filtered and masked.
pub struct Columns<'a> {
    combinations: &'a [Combination],
    /// Numbers that are added to the first of the combinations.
    biases: &'a [f64],
    /// The filter of each row.
    filters: Vec<&'a [f64]>,
    /// Samples of the past that a filter reaches back to.
    order: usize,
    /// For each row the last `order` steps of the block before, then the block's.
    windows: Vec<f64>,
    /// For each row the first `order` steps of every lane.
    heads: Vec<f64>,
    /// Filtered rows, filled up with rows of zeros to a whole number of tiles.
    rows: Vec<f64>,
    /// Steps of the last block; none before the first one.
    steps: Option<usize>,
}

impl<'a> Columns<'a> {
    /// The last of the `combinations` is zero where a sample counts and not a number where it is masked; `filters`, one for
    /// each of them, are of one length of at most [`STEPS`].
    pub fn new(combinations: &'a [Combination], filters: Vec<&'a [f64]>, biases: &'a [f64]) -> Self {
        let order = filters[0].len() - 1;
        let rows = combinations.len();
        let mut windows = vec![0.0; rows * (order + STEPS) * LANES];
        // Before the record nothing was measured.
        let width = (order + STEPS) * LANES;
        windows[(rows - 1) * width..].fill(f64::NAN);
        Self {
            combinations,
            biases,
            filters,
            order,
            windows,
            heads: vec![0.0; rows * order * LANES],
            rows: vec![0.0; Sums::space(rows) * BLOCK],
            steps: None,
        }
    }

    /// Add up the products of a block, whose first rows are the measured outputs.
    pub fn add(&mut self, block: &mut Block<'_>, sums: &mut Sums) {
        let (history, width) = self.widths();
        if let Some(steps) = self.steps.filter(|_| history > 0) {
            for window in self.windows.chunks_exact_mut(width) {
                window.copy_within(steps * LANES..steps * LANES + history, 0);
            }
        }
        let (into, width) = if history > 0 { (&mut self.windows, width) } else { (&mut self.rows, BLOCK) };
        arch().dispatch(Combine {
            block: block.rows(),
            combinations: self.combinations,
            biases: self.biases,
            into,
            width,
        });
        if self.steps.is_none() && history > 0 {
            for (head, window) in self.heads.chunks_exact_mut(history).zip(self.windows.chunks_exact(width)) {
                head.copy_from_slice(&window[history..2 * history]);
            }
        }
        self.steps = Some(block.steps());
        self.finish(sums);
    }

    /// Add the steps left out before: each lane's first ones, whose past is the end of the lane before.
    pub fn add_seams(&mut self, sums: &mut Sums) {
        let (history, width) = self.widths();
        let Some(steps) = self.steps.filter(|_| history > 0) else { return };
        let last = self.combinations.len() - 1;
        let windows = self.windows.chunks_exact_mut(width).zip(self.heads.chunks_exact(history));
        for (row, (window, head)) in windows.enumerate() {
            window.copy_within(steps * LANES..steps * LANES + history, 0);
            let nothing = if row == last { f64::NAN } else { 0.0 };
            for pack in window[..history].chunks_exact_mut(LANES) {
                pack.copy_within(..LANES - 1, 1);
                pack[0] = nothing;
            }
            window[history..2 * history].copy_from_slice(head);
            window[2 * history..].fill(nothing);
        }
        self.finish(sums);
    }

    /// Number of values kept of a row before a block, and of these and the block together.
    fn widths(&self) -> (usize, usize) {
        (self.order * LANES, (self.order + STEPS) * LANES)
    }

    fn finish(&mut self, sums: &mut Sums) {
        let arch = arch();
        let rows = &mut self.rows[..self.combinations.len() * BLOCK];
        if self.order > 0 {
            arch.dispatch(Filter { windows: &self.windows, filters: &self.filters, rows });
        }
        sums.count += arch.dispatch(Mask { rows });
        sums.add(&self.rows);
    }
}

/// Write combinations of a block's rows, each at the end of a window of `width` values, after its past.
pub struct Combine<'a> {
    pub block: &'a [f64],
    pub combinations: &'a [Combination],
    pub biases: &'a [f64],
    pub into: &'a mut [f64],
    pub width: usize,
}

impl WithSimd for Combine<'_> {
    type Output = ();

    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // an iterator that is not inlined would not be compiled for the machine's vectors
    fn with_simd<S: Simd>(self, simd: S) {
        let vectors = BLOCK / S::F64_LANES;
        let block = S::as_simd_f64s(self.block).0;
        for (row, combination) in self.combinations.iter().enumerate() {
            let into = &mut self.into[row * self.width..][..self.width];
            let into = S::as_mut_simd_f64s(&mut into[self.width - BLOCK..]).0;
            let bias = if row < self.biases.len() { self.biases[row] } else { 0.0 };
            let into = &mut into[..vectors];
            if combination.is_empty() {
                for at in 0..vectors {
                    into[at] = simd.splat_f64s(bias);
                }
            }
            for (term, &(source, factor)) in combination.iter().enumerate() {
                let source = &block[source * vectors..][..vectors];
                let factor = simd.splat_f64s(factor);
                // One sweep for each term, without an inner loop, so that all code is vector code.
                if term == 0 {
                    for at in 0..vectors {
                        into[at] = simd.mul_add_e_f64s(factor, source[at], simd.splat_f64s(bias));
                    }
                } else {
                    for at in 0..vectors {
                        into[at] = simd.mul_add_e_f64s(factor, source[at], into[at]);
                    }
                }
            }
        }
    }
}

/// Filter each row's window.
struct Filter<'a> {
    windows: &'a [f64],
    filters: &'a [&'a [f64]],
    rows: &'a mut [f64],
}

impl WithSimd for Filter<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (vectors, step) = (BLOCK / S::F64_LANES, LANES / S::F64_LANES);
        let windows = S::as_simd_f64s(self.windows).0;
        let rows = S::as_mut_simd_f64s(self.rows).0;
        for (row, filter) in self.filters.iter().enumerate() {
            let history = (filter.len() - 1) * step;
            let window = &windows[row * (history + vectors)..][..history + vectors];
            for at in (0..vectors).step_by(ABREAST) {
                let mut sums = [simd.splat_f64s(0.0); ABREAST];
                for (lag, &factor) in filter.iter().enumerate() {
                    let factor = simd.splat_f64s(factor);
                    let past = &window[history + at - lag * step..][..ABREAST];
                    for i in 0..ABREAST {
                        sums[i] = simd.mul_add_e_f64s(factor, past[i], sums[i]);
                    }
                }
                for i in 0..ABREAST {
                    rows[row * vectors + at + i] = sums[i];
                }
            }
        }
    }
}

/// Set all rows to zero where the last one is not a number, and it to one elsewhere. Gives the number of the latter.
struct Mask<'a> {
    rows: &'a mut [f64],
}

impl WithSimd for Mask<'_> {
    type Output = usize;

    #[inline(always)]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // counts up to BLOCK
    fn with_simd<S: Simd>(self, simd: S) -> usize {
        let vectors = BLOCK / S::F64_LANES;
        let rows = S::as_mut_simd_f64s(self.rows).0;
        let last = rows.len() - vectors;
        let (zero, one) = (simd.splat_f64s(0.0), simd.splat_f64s(1.0));
        let mut count = zero;
        for at in 0..vectors {
            let valid = simd.equal_f64s(rows[last + at], zero);
            if simd.first_true_m64s(simd.not_m64s(valid)) < S::F64_LANES {
                for row in (at..last).step_by(vectors) {
                    rows[row] = simd.select_f64s(valid, rows[row], zero);
                }
            }
            rows[last + at] = simd.select_f64s(valid, one, zero);
            count = simd.add_f64s(count, rows[last + at]);
        }
        simd.reduce_sum_f64s(count) as usize
    }
}
