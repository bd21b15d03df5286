//! Products of whitened residuals, derivatives and systematic errors for the normal equations, in one pass.
//!
//! Systematic errors are errors of an output's gauge and calibration that vary slowly with frequency.

use pulp::Simd;

use super::complex::Complex;
use super::equations::Equations;
use super::plan::{Aligned, BLOCK, Late, Spectra, TILE, padded};
use super::residual::{Sink, Square, each_block};
use crate::error::{Result, require};
use crate::stop::Stop;

/// Noise of a record, and systematic errors of its outputs.
#[derive(Debug, Clone, Copy)]
pub struct Noise<'a> {
    /// Root of the inverse spectral matrix, a lower triangle, [O, O, 2, F].
    pub root: &'a [f64],
    /// Whitened shape of each output's error, [O, O, 2, F]: row of the whitened output, column of the error. Empty: none.
    pub shapes: &'a [f64],
    /// Hat functions of the errors, [K, F].
    pub hats: &'a [f64],
}

/// The products.
#[derive(Debug)]
pub struct Products {
    /// Products of residual and derivatives, [C, C].
    pub gram: Vec<f64>,
    /// Products of systematic errors with residual and derivatives, [O, 2, K, C].
    pub errors: Vec<f64>,
}

struct Sums<'a> {
    noise: Noise<'a>,
    count: usize,
    /// Number of columns of residual and derivatives, without and with padding.
    columns: usize,
    padded: usize,
    /// Projection of columns on the systematic errors.
    turned: Aligned,
    /// Shapes of a block, [O, O, 2, BLOCK], and its nonzero hats, [near, BLOCK].
    shapes: Aligned,
    hats: Aligned,
    /// Sums of each pair of columns, one per lane, [padded, padded, LANES].
    gram: Aligned,
    /// Sums of each hat, column, output and part, one per lane, [K, C, O, 2, LANES].
    errors: Aligned,
    /// Nonzero hats of a block.
    near: Vec<usize>,
}

/// Lanes per sum.
const LANES: usize = 8;

impl Sink for Sums<'_> {
    #[inline(always)]
    fn weigh<S: Simd, const O: usize>(&self, simd: S, place: usize, outputs: Square<S, O>) -> Square<S, O> {
        let mut found = outputs;
        for a in 0..O {
            let mut row = [Complex::zero(simd); O];
            for b in 0..=a {
                let root = part(simd, self.noise.root, a * O + b, self.count, place);
                for c in 0..O {
                    row[c] = row[c].plus_product(simd, root, outputs[b][c]);
                }
            }
            found[a] = row;
        }
        found
    }

    #[inline(always)]
    fn take<S: Simd, const O: usize>(&mut self, simd: S, first: usize, rows: &[f64]) {
        let length = O * 2 * BLOCK;
        if self.columns == 1 {
            tile::<S, 1>(simd, rows, length, [0, 0], self.gram.get_mut(), 1);
        } else {
            for i in (0..self.padded).step_by(TILE) {
                for j in (i..self.padded).step_by(TILE) {
                    tile::<S, TILE>(simd, rows, length, [i, j], self.gram.get_mut(), self.padded);
                }
            }
        }
        if self.noise.shapes.is_empty() {
            return;
        }
        self.near.clear();
        for knot in 0..self.noise.hats.len() / self.count {
            let mut sum = simd.splat_f64s(0.0);
            for value in S::as_simd_f64s(&self.noise.hats[knot * self.count + first..][..BLOCK]).0 {
                sum = simd.mul_add_e_f64s(*value, *value, sum);
            }
            if simd.reduce_sum_f64s(sum) != 0.0 {
                let hat = &self.noise.hats[knot * self.count + first..][..BLOCK];
                self.hats.get_mut()[self.near.len() * BLOCK..][..BLOCK].copy_from_slice(hat);
                self.near.push(knot);
            }
        }
        for (number, shape) in self.shapes.get_mut().chunks_exact_mut(BLOCK).enumerate() {
            shape.copy_from_slice(&self.noise.shapes[number * self.count + first..][..BLOCK]);
        }
        for column in 0..self.columns {
            self.bent::<S, O>(simd, &rows[column * length..][..length], column);
        }
    }
}

/// Add a tile of products of rows.
#[inline(always)]
fn tile<S: Simd, const T: usize>(
    simd: S,
    rows: &[f64],
    length: usize,
    [i, j]: [usize; 2],
    sums: &mut [f64],
    columns: usize,
) {
    let (mut a, mut b) = ([&[] as &[S::f64s]; T], [&[] as &[S::f64s]; T]);
    for k in 0..T {
        a[k] = S::as_simd_f64s(&rows[(i + k) * length..][..length]).0;
        b[k] = S::as_simd_f64s(&rows[(j + k) * length..][..length]).0;
    }
    let mut found = [[simd.splat_f64s(0.0); T]; T];
    for place in 0..length / S::F64_LANES {
        for k in 0..T {
            for l in 0..T {
                found[k][l] = simd.mul_add_e_f64s(a[k][place], b[l][place], found[k][l]);
            }
        }
    }
    for k in 0..T {
        for l in 0..T {
            let at = ((i + k) * columns + j + l) * LANES;
            let sum = &mut S::as_mut_simd_f64s(&mut sums[at..at + LANES]).0[0];
            *sum = simd.add_f64s(*sum, found[k][l]);
        }
    }
}

/// Complex numbers of a table [numbers, 2, F].
#[inline(always)]
fn part<S: Simd>(_: S, values: &[f64], number: usize, count: usize, place: usize) -> Complex<S> {
    let start = number * 2 * count;
    Complex {
        re: S::as_simd_f64s(&values[start..start + count]).0[place],
        im: S::as_simd_f64s(&values[start + count..start + 2 * count]).0[place],
    }
}

impl Sums<'_> {
    /// Project a whitened column of a block on the systematic errors, and add its products with the hats.
    #[inline(always)]
    fn bent<S: Simd, const O: usize>(&mut self, simd: S, white: &[f64], column: usize) {
        let vectors = BLOCK / S::F64_LANES;
        let white = &S::as_simd_f64s(white).0[..O * 2 * vectors];
        let shapes = &S::as_simd_f64s(self.shapes.get()).0[..O * O * 2 * vectors];
        let turned = &mut S::as_mut_simd_f64s(self.turned.get_mut()).0[..O * 2 * vectors];
        for b in 0..O {
            for place in 0..vectors {
                let mut sum = Complex::zero(simd);
                for a in b..O {
                    let at = 2 * (a * O + b) * vectors + place;
                    let shape = Complex { re: shapes[at], im: shapes[at + vectors] };
                    let row = Complex {
                        re: white[2 * a * vectors + place],
                        im: white[(2 * a + 1) * vectors + place],
                    };
                    sum = sum.plus_product(simd, row, shape.conjugate(simd));
                }
                turned[2 * b * vectors + place] = sum.re;
                turned[(2 * b + 1) * vectors + place] = sum.im;
            }
        }
        for (&knot, hat) in self.near.iter().zip(self.hats.get().chunks_exact(BLOCK)) {
            let hat = &S::as_simd_f64s(hat).0[..vectors];
            let at = (knot * self.columns + column) * 2 * O * LANES;
            let sums = &mut self.errors.get_mut()[at..at + 2 * O * LANES];
            let mut found = [[simd.splat_f64s(0.0); 2]; O];
            for place in 0..vectors {
                for b in 0..O {
                    for half in 0..2 {
                        let row = turned[(2 * b + half) * vectors + place];
                        found[b][half] = simd.mul_add_e_f64s(hat[place], row, found[b][half]);
                    }
                }
            }
            for b in 0..O {
                for half in 0..2 {
                    let at = (2 * b + half) * LANES;
                    let sum = &mut S::as_mut_simd_f64s(&mut sums[at..at + LANES]).0[0];
                    *sum = simd.add_f64s(*sum, found[b][half]);
                }
            }
        }
    }
}

/// Products of a record's rows in units of its noise.
///
/// # Errors
/// [`crate::error::Error::Invalid`] for arrays whose lengths disagree.
pub fn products(
    equations: &Equations,
    spectra: Spectra<'_>,
    late: &[Late<'_>],
    noise: Noise<'_>,
    stop: &Stop,
) -> Result<Products> {
    let (count, outputs) = (spectra.count, equations.outputs.len());
    spectra.require(late)?;
    let square = outputs * outputs * 2 * count;
    require(noise.root.len() == square, || {
        format!("root: found {} numbers, expected {square}", noise.root.len())
    })?;
    require(noise.shapes.is_empty() || noise.shapes.len() == square, || {
        format!("shapes: found {} numbers, expected {square} or none", noise.shapes.len())
    })?;
    require(noise.hats.len().is_multiple_of(count), || {
        format!("hats: found {} numbers, expected a multiple of {count}", noise.hats.len())
    })?;
    let (columns, padded) = (1 + equations.slopes.len(), padded(equations));
    let knots = if noise.shapes.is_empty() { 0 } else { noise.hats.len() / count };
    let mut sums = Sums {
        noise,
        count,
        columns,
        padded,
        turned: Aligned::new(outputs * 2 * BLOCK),
        shapes: Aligned::new(outputs * outputs * 2 * BLOCK),
        hats: Aligned::new(knots * BLOCK),
        gram: Aligned::new(padded * padded * LANES),
        errors: Aligned::new(knots * columns * outputs * 2 * LANES),
        near: Vec::with_capacity(knots),
    };
    each_block(equations, spectra, late, &mut sums, stop)?;
    let mut gram = vec![0.0; columns * columns];
    for i in 0..columns {
        for j in i..columns {
            let value = sums.gram.get()[(i * padded + j) * LANES..][..LANES].iter().sum();
            gram[i * columns + j] = value;
            gram[j * columns + i] = value;
        }
    }
    let mut errors = Vec::with_capacity(outputs * 2 * knots * columns);
    for half in 0..2 * outputs {
        for place in 0..knots * columns {
            errors.push(sums.errors.get()[(place * 2 * outputs + half) * LANES..][..LANES].iter().sum());
        }
    }
    Ok(Products { gram, errors })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::two_equations::equations::{COUNT, ORDERS, SIGNALS, Setup, at};
    use crate::two_equations::residuals;
    use proptest::prelude::*;

    /// Pseudo-random numbers between -1 and 1.
    fn numbers(count: usize, seed: u64) -> Vec<f64> {
        (0..count).map(|k| ((k as f64 + 1.0) * (seed as f64 + 12.9898)).sin()).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        /// With unit noise in all outputs and at all frequencies, the products are those of the unweighted rows.
        #[test]
        fn products_in_units_of_one_are_those_of_the_rows(
            seed in 0..1000_u64,
            blocks in 1..4_usize,
            outputs in prop::sample::select(vec![vec![0], vec![1, 0], vec![0, 2, 1], vec![3, 0, 1], vec![2, 3, 1, 0]]),
            wrt in prop::collection::vec(0..COUNT, 0..20),
        ) {
            let count = blocks * BLOCK;
            let (size, number) = (ORDERS * 2 * count, outputs.len());
            let mut q = [0.1; COUNT];
            (q[at::TAU_N], q[at::S_M], q[at::TAU_TWIST]) = (1.5, 1.1, 0.0);
            let setup = Setup { gauge: true, ..Setup::default() };
            let equations = Equations::new(&q, &outputs, setup, &wrt)?;
            let values = numbers(SIGNALS.len() * size, seed);
            let spectra = Spectra { values: &values, count, spacing: 0.05 };
            let late = [Late { values: &values[size..2 * size], rest: 0.01 }; 2];
            let mut root = vec![0.0; number * number * 2 * count];
            for a in 0..number {
                root[(a * number + a) * 2 * count..][..count].fill(1.0);
            }
            let hats = vec![1.0; count];
            let noise = Noise { root: &root, shapes: &root, hats: &hats };
            let found = products(&equations, spectra, &late, noise, &Stop::new())?;
            let rows = residuals(&equations, spectra, &late, &Stop::new())?;
            let (columns, length) = (1 + wrt.len(), number * 2 * count);
            for i in 0..columns {
                let row = &rows[i * length..][..length];
                for j in 0..columns {
                    let other = &rows[j * length..][..length];
                    let (mut sum, mut size) = (0.0, 0.0);
                    for (a, b) in row.iter().zip(other) {
                        sum += a * b;
                        size += (a * b).abs();
                    }
                    prop_assert!((found.gram[i * columns + j] - sum).abs() <= 1e-12 * size);
                }
                for half in 0..2 * number {
                    let part = &row[half * count..][..count];
                    let (sum, size) = (part.iter().sum::<f64>(), part.iter().map(|x| x.abs()).sum::<f64>());
                    prop_assert!((found.errors[half * columns + i] - sum).abs() <= 1e-12 * size);
                }
            }
        }
    }
}
