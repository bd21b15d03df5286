//! The all-pole filter run backwards in time, over blocks of rows.

use std::array::from_fn;

use pulp::{Simd, WithSimd};

use crate::error::{Result, require};
use crate::instruction_set::arch;
use crate::linear::segmented_pass::BLOCK;
use crate::subnormal::cut_all;

/// Coefficients that the filter has at most, and samples that it takes at a time.
pub const ORDER: usize = 8;

/// `y[k] = x[k] - sum_i model[i] y[k + i]`, `i` from 1 on.
///
/// A recursion waits for the value before; so it is solved for `ORDER` samples at once, in terms of these and of the `ORDER`
/// results that follow.
#[derive(Debug, Clone)]
pub struct AllPole {
    /// Change of the results for one unit in each sample.
    by_sample: [[f64; ORDER]; ORDER],
    /// Change of the results for one unit in each of the results that follow in time.
    by_result: [[f64; ORDER]; ORDER],
    idle: bool,
}

impl AllPole {
    /// `model` from `i = 1` on.
    ///
    /// # Errors
    /// [`Error::Invalid`](crate::error::Error::Invalid) for more than [`ORDER`] coefficients, or one that is not finite.
    pub fn new(model: &[f64]) -> Result<Self> {
        require(model.len() <= ORDER && model.iter().all(|factor| factor.is_finite()), || {
            format!("model is {model:?}, expected up to {ORDER} finite numbers")
        })?;
        let answer = |one: usize| -> [f64; ORDER] {
            let mut values: [f64; 2 * ORDER] = from_fn(|k| f64::from(u8::from(k == one)));
            for k in (0..ORDER).rev() {
                values[k] -=
                    model.iter().zip(&values[k + 1..]).map(|(factor, later)| factor * later).sum::<f64>();
            }
            from_fn(|k| values[k])
        };
        Ok(Self {
            by_sample: from_fn(answer),
            by_result: from_fn(|one| answer(ORDER + one)),
            idle: model.iter().all(|factor| *factor == 0.0),
        })
    }

    /// Filter a block of each of some rows in place; `after` are each row's first results of the block that follows in time,
    /// and become those of this one.
    pub fn run(&self, rows: &mut [f64], after: &mut [[f64; ORDER]]) {
        if !self.idle {
            arch().dispatch(Recursion { filter: self, rows, after });
            cut_all(after.as_flattened_mut());
        }
    }
}

struct Recursion<'a> {
    filter: &'a AllPole,
    rows: &'a mut [f64],
    after: &'a mut [[f64; ORDER]],
}

impl WithSimd for Recursion<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match ORDER / S::F64_LANES {
            1 => self.in_parts::<S, 1>(simd),
            2 => self.in_parts::<S, 2>(simd),
            4 => self.in_parts::<S, 4>(simd),
            _ => self.in_parts::<S, ORDER>(simd),
        }
    }
}

impl Recursion<'_> {
    /// `ORDER` samples are so many vectors.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // an iterator that is not inlined would not be compiled for the machine's vectors
    fn in_parts<S: Simd, const PARTS: usize>(self, simd: S) {
        let load = |from: &[[f64; ORDER]; ORDER]| {
            let mut vectors = [[simd.splat_f64s(0.0); ORDER]; PARTS];
            for part in 0..PARTS {
                for k in 0..ORDER {
                    vectors[part][k] = S::as_simd_f64s(&from[k]).0[part];
                }
            }
            vectors
        };
        let (by_sample, by_result) = (load(&self.filter.by_sample), load(&self.filter.by_result));
        // Rows in the inner loop: while one waits for its own results the others go on.
        for first in (0..BLOCK).step_by(ORDER).rev() {
            for row in 0..self.after.len() {
                let samples = &mut self.rows[row * BLOCK + first..][..ORDER];
                let after = &mut self.after[row];
                let mut results = [0.0; ORDER];
                for part in 0..PARTS {
                    let mut sum = simd.splat_f64s(0.0);
                    for k in 0..ORDER {
                        sum = simd.mul_add_e_f64s(by_sample[part][k], simd.splat_f64s(samples[k]), sum);
                    }
                    for k in 0..ORDER {
                        sum = simd.mul_add_e_f64s(by_result[part][k], simd.splat_f64s(after[k]), sum);
                    }
                    S::as_mut_simd_f64s(&mut results).0[part] = sum;
                }
                samples.copy_from_slice(&results);
                *after = results;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_from_the_last_to_the_first_give_the_recursion() {
        let model = [-1.2, 0.5, -0.1];
        let filter = AllPole::new(&model).expect("fits");
        let length = 2 * BLOCK;
        let series =
            |row: usize| (0..length).map(|k| ((row + 1) * k * k) as f64).map(f64::sin).collect::<Vec<_>>();
        let rows: Vec<Vec<f64>> = (0..3).map(series).collect();
        let mut after = vec![[0.0; ORDER]; rows.len()];
        let mut found = vec![vec![]; rows.len()];
        for first in [BLOCK, 0] {
            let mut block: Vec<f64> =
                rows.iter().flat_map(|row| row[first..first + BLOCK].to_vec()).collect();
            filter.run(&mut block, &mut after);
            for (found, part) in found.iter_mut().zip(block.chunks(BLOCK)) {
                *found = [part, &found[..]].concat();
            }
        }
        for (x, y) in rows.iter().zip(&found) {
            for k in 0..length {
                let later: f64 = model.iter().zip(&y[k + 1..]).map(|(factor, later)| factor * later).sum();
                assert!((y[k] - (x[k] - later)).abs() < 1e-13);
            }
        }
        assert!(AllPole::new(&[0.1; ORDER + 1]).is_err());
    }
}
