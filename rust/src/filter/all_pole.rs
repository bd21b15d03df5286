//! The all-pole filter run backwards in time, over many rows side by side.

use pulp::{Arch, Simd, WithSimd};

use crate::error::{Result, require};

/// Rows in one pack of vectors.
const ABREAST: usize = 8;

type Pack = [f64; ABREAST];

/// Filter rows of so many samples: `y[k] = x[k] - sum_i model[i] y[k + i]`, `model` from `i = 1` on.
///
/// `after` holds as many samples of each row's result as `model` reaches to: those that follow the last sample.
///
/// # Errors
/// [`Error::Invalid`](crate::error::Error::Invalid) for lengths that don't fit.
#[allow(clippy::needless_range_loop)]
pub fn all_pole_backwards(rows: &[f64], samples: usize, model: &[f64], after: &[f64]) -> Result<Vec<f64>> {
    let (order, samples) = (model.len(), samples.max(1));
    let count = rows.len() / samples;
    require(rows.len() == count * samples && after.len() == count * order, || {
        format!("after has {} values, expected {order} for each of {count} rows", after.len())
    })?;
    let mut filtered = vec![0.0; rows.len()];
    let mut packs = vec![[0.0; ABREAST]; samples + order];
    for first in (0..count).step_by(ABREAST) {
        let abreast = ABREAST.min(count - first);
        // Slices of one length and plain indices: an iterator over every eighth value would cost more than the filter.
        let row = |lane: usize| &rows[(first + lane.min(abreast - 1)) * samples..][..samples];
        let source: [&[f64]; ABREAST] = [row(0), row(1), row(2), row(3), row(4), row(5), row(6), row(7)];
        let into = &mut packs[..samples];
        for k in 0..samples {
            for lane in 0..ABREAST {
                into[k][lane] = source[lane][k];
            }
        }
        for (i, pack) in packs[samples..].iter_mut().enumerate() {
            for lane in 0..abreast {
                pack[lane] = after[(first + lane) * order + i];
            }
        }
        Arch::new().dispatch(Recursion { model, packs: &mut packs });
        for lane in 0..abreast {
            let row = &mut filtered[(first + lane) * samples..][..samples];
            for (value, pack) in row.iter_mut().zip(&packs) {
                *value = pack[lane];
            }
        }
    }
    Ok(filtered)
}

struct Recursion<'a> {
    model: &'a [f64],
    packs: &'a mut [Pack],
}

impl WithSimd for Recursion<'_> {
    type Output = ();

    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // an iterator that is not inlined would not be compiled for the machine's vectors
    fn with_simd<S: Simd>(self, simd: S) {
        let Some((&nearest, far)) = self.model.split_first() else { return };
        let nearest = simd.splat_f64s(-nearest);
        let order = self.model.len();
        for part in 0..ABREAST / S::F64_LANES {
            let mut next = S::as_simd_f64s(&self.packs[self.packs.len() - order]).0[part];
            for k in (0..self.packs.len() - order).rev() {
                let mut sum = S::as_simd_f64s(&self.packs[k]).0[part];
                // The value just computed comes last: nothing else waits for it.
                let later = &self.packs[k + 2..][..far.len()];
                for i in 0..far.len() {
                    let value = S::as_simd_f64s(&later[i]).0[part];
                    sum = simd.mul_add_e_f64s(simd.splat_f64s(-far[i]), value, sum);
                }
                next = simd.mul_add_e_f64s(nearest, next, sum);
                S::as_mut_simd_f64s(&mut self.packs[k]).0[part] = next;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_give_what_the_whole_gives_and_the_whole_is_the_recursion() {
        let (count, samples, model) = (11, 40, [-1.2, 0.5, -0.1]);
        let rows: Vec<f64> = (0..count * samples).map(|i| ((i * i) as f64).sin()).collect();
        let rest = vec![0.0; count * 3];
        let whole = all_pole_backwards(&rows, samples, &model, &rest).expect("fits");
        for (x, y) in rows.chunks(samples).zip(whole.chunks(samples)) {
            for k in 0..samples {
                let later: f64 = (1..=3).filter(|i| k + i < samples).map(|i| model[i - 1] * y[k + i]).sum();
                assert!((y[k] - (x[k] - later)).abs() < 1e-14);
            }
        }
        let cut = |rows: &[f64], from: usize, to: usize| -> Vec<f64> {
            rows.chunks(samples).flat_map(|row| row[from..to].to_vec()).collect()
        };
        let after = cut(&whole, 17, 20);
        let first = all_pole_backwards(&cut(&rows, 0, 17), 17, &model, &after).expect("fits");
        assert_eq!(first, cut(&whole, 0, 17));
        assert!(all_pole_backwards(&rows, samples, &model, &after[1..]).is_err());
    }
}
