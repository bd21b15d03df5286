//! Residuals of the outputs and their derivatives at all frequencies.
//!
//! A taper w and an operator H do not commute: `F[w (H x)] = sum_k H^(k)(s) / k! F[(-1)^k w^(k) x]`. Let
//! `x_k` be the spectrum `F[(-1)^k w^(k) x]`. Then s acts as `(s x)_k = s x_k + x_{k+1}`, and a delay of t as
//! `exp(-s t) sum_j (-t)^j / j! x_{k+j}`.

use pulp::{Simd, WithSimd};

use super::complex::{Complex, negative};
use super::equations::{DEGREES, Equations, at, signal};
use super::plan::{Aligned, BLOCK, Item, Late, MOST, Plan, SHOWN, Spectra, TILE, load, store};
use super::signals::{Turns, lay_out};
use crate::error::Result;
use crate::instruction_set::arch;
use crate::stop::Stop;

/// A square matrix for each of the neighbouring frequencies that one SIMD vector holds.
pub type Square<S, const O: usize> = [[Complex<S>; O]; O];

/// Consumer of residual and derivatives (the rows) of each block of neighbouring frequencies.
pub trait Sink {
    /// Weights of the rows. `outputs` is the matrix from equations to outputs; `place` is the index of a SIMD vector
    /// of frequencies.
    fn weigh<S: Simd, const O: usize>(&self, simd: S, place: usize, outputs: Square<S, O>) -> Square<S, O>;
    /// Process the rows of the block that starts at frequency `first`: `1 + W` columns of [outputs, 2, BLOCK], zero-padded
    /// to whole tiles.
    fn take<S: Simd, const O: usize>(&mut self, simd: S, first: usize, rows: &[f64]);
}

/// Compute all blocks with the widest vectors of this machine.
pub fn each_block(
    equations: &Equations,
    spectra: Spectra<'_>,
    late: &[Late<'_>],
    sink: &mut impl Sink,
    stop: &Stop,
) -> Result<()> {
    struct Run<'a, K>(&'a Equations, Spectra<'a>, &'a [Late<'a>], &'a mut K, &'a Stop);
    impl<K: Sink> WithSimd for Run<'_, K> {
        type Output = Result<()>;
        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Result<()> {
            let Self(equations, spectra, late, sink, stop) = self;
            match equations.outputs.len() {
                1 => blocks::<S, 1>(simd, &Plan::new(equations, spectra, late), sink, stop),
                2 => blocks::<S, 2>(simd, &Plan::new(equations, spectra, late), sink, stop),
                3 => blocks::<S, 3>(simd, &Plan::new(equations, spectra, late), sink, stop),
                _ => blocks::<S, MOST>(simd, &Plan::new(equations, spectra, late), sink, stop),
            }
        }
    }
    arch().dispatch(Run(equations, spectra, late, sink, stop))
}

#[inline(always)]
fn blocks<S: Simd, const O: usize>(
    simd: S,
    plan: &Plan<'_, O>,
    sink: &mut impl Sink,
    stop: &Stop,
) -> Result<()> {
    let (lanes, spacing) = (S::F64_LANES, plan.spectra.spacing);
    let (columns, length) = (plan.items.len(), O * 2 * BLOCK);
    let padded = if columns == 1 { 1 } else { columns.next_multiple_of(TILE) };
    let mut rows = Aligned::new(padded * length);
    let mut powers = Aligned::new(plan.size * 2 * BLOCK);
    let mut weights = Aligned::new(O * length);
    let (rows, powers, weights) = (rows.get_mut(), powers.get_mut(), weights.get_mut());
    let mut turns = Turns::new(simd, plan);
    let mut ramp = [0.0; 16];
    for (lane, value) in ramp.iter_mut().enumerate() {
        *value = spacing * lane as f64;
    }
    let ramp = S::as_simd_f64s(&ramp[..lanes]).0[0];
    for first in (0..plan.spectra.count).step_by(BLOCK) {
        stop.check()?;
        for inner in 0..BLOCK / lanes {
            let place = first / lanes + inner;
            let omega = simd.add_f64s(ramp, simd.splat_f64s(spacing * (place * lanes) as f64));
            lay_out(simd, plan, &turns, omega, place, powers, inner);
            let mut left = [Complex::zero(simd); O];
            for equation in 0..O {
                left[equation] = summed(simd, &plan.items[0][equation], powers, inner);
            }
            let inverse = inverted(simd, matrix(simd, plan, &turns, omega));
            if columns > 1 {
                let residual = product(simd, &inverse, &left);
                answered(simd, plan, &turns, omega, &residual, powers, inner);
            }
            let weight = sink.weigh(simd, place, shown(simd, plan, &turns, inverse));
            let residual = product(simd, &weight, &left);
            for a in 0..O {
                store(residual[a], rows, a, inner);
                for b in 0..O {
                    // The model's derivative: the residual is the data minus the model.
                    store(Complex::zero(simd).minus(simd, weight[a][b]), weights, a * O + b, inner);
                }
            }
            turns.advance(simd);
        }
        for (items, row) in plan.items.iter().zip(rows.chunks_exact_mut(length)).skip(1) {
            weighed::<S, O>(simd, items, powers, weights, row);
        }
        sink.take::<S, O>(simd, first, rows);
    }
    Ok(())
}

/// Matrix of the equations about N = 1, from outputs to equations.
#[inline(always)]
fn matrix<S: Simd, const O: usize>(
    simd: S,
    plan: &Plan<'_, O>,
    turns: &Turns<S>,
    omega: S::f64s,
) -> Square<S, O> {
    let mut found = [[Complex::zero(simd); O]; O];
    let minus = negative(simd, simd.mul_f64s(omega, omega));
    let dead = turns.dead.now.scaled(simd, turns.hold(simd)[0]);
    for equation in 0..O {
        for column in 0..O {
            found[equation][column] = polynomial(simd, &plan.near[equation][column], omega, minus);
        }
        // The speed is the first output, the torque the second.
        for column in 0..O.min(if plan.lengths[signal::LATE_M] > 0 { 2 } else { 1 }) {
            let fed = polynomial(simd, &plan.fed[equation][column], omega, minus);
            found[equation][column] = found[equation][column].plus_product(simd, fed, dead);
        }
    }
    found
}

/// A polynomial at j omega, given -omega^2.
#[inline(always)]
fn polynomial<S: Simd>(simd: S, c: &[f64; DEGREES], omega: S::f64s, minus: S::f64s) -> Complex<S> {
    let (mut even, mut odd) = (simd.splat_f64s(c[DEGREES - 2]), simd.splat_f64s(c[DEGREES - 1]));
    for power in [4, 2, 0] {
        even = simd.mul_add_e_f64s(even, minus, simd.splat_f64s(c[power]));
    }
    for power in [5, 3, 1] {
        odd = simd.mul_add_e_f64s(odd, minus, simd.splat_f64s(c[power]));
    }
    Complex { re: even, im: simd.mul_f64s(odd, omega) }
}

/// Subtract the residuals from the signals, so that derivatives of the equations are those at the model's outputs.
#[inline(always)]
fn answered<S: Simd, const O: usize>(
    simd: S,
    plan: &Plan<'_, O>,
    turns: &Turns<S>,
    omega: S::f64s,
    residual: &[Complex<S>; O],
    powers: &mut [f64],
    inner: usize,
) {
    for column in 0..O {
        answer(simd, plan, omega, SHOWN[plan.outputs[column]], residual[column], powers, inner);
    }
    let [cosine, sine] = turns.hold(simd);
    for (column, near, far) in [(0, signal::LATE_N, signal::APART_N), (1, signal::LATE_M, signal::APART_M)] {
        if column >= O || plan.lengths[near] == 0 {
            continue;
        }
        let fed = residual[column].times(simd, turns.dead.now);
        answer(simd, plan, omega, near, fed.scaled(simd, cosine), powers, inner);
        // sinh(j x) = j sin(x)
        let apart = fed.scaled(simd, sine);
        let apart = Complex { re: negative(simd, apart.im), im: apart.re };
        answer(simd, plan, omega, far, apart, powers, inner);
    }
}

/// Subtract a value from a signal.
#[inline(always)]
fn answer<S: Simd, const O: usize>(
    simd: S,
    plan: &Plan<'_, O>,
    omega: S::f64s,
    known: usize,
    mut less: Complex<S>,
    powers: &mut [f64],
    inner: usize,
) {
    for slot in plan.slots[known]..plan.slots[known] + plan.lengths[known] {
        store(load(simd, powers, slot, inner).minus(simd, less), powers, slot, inner);
        less = less.risen(simd, omega, Complex::zero(simd));
    }
}

/// Outputs from equations in the caller's order, with delays and scales of the sensors.
#[inline(always)]
fn shown<S: Simd, const O: usize>(
    simd: S,
    plan: &Plan<'_, O>,
    turns: &Turns<S>,
    inverse: Square<S, O>,
) -> Square<S, O> {
    let mut found = inverse;
    for index in 0..O {
        let mut row = inverse[index];
        if plan.outputs[index] == 0 && plan.q[at::T_N] != 0.0 {
            for value in &mut row {
                *value = value.times(simd, turns.speed.now.conjugate(simd));
            }
        }
        for (output, turn, scale) in
            [(1, turns.torque.now, plan.q[at::S_M]), (3, turns.brake.now, plan.q[at::S_B])]
        {
            if plan.outputs[index] == output {
                let scale = simd.splat_f64s(scale);
                for value in &mut row {
                    *value = value.times(simd, turn.conjugate(simd)).scaled(simd, scale);
                }
            }
        }
        found[plan.places[index]] = row;
    }
    found
}

/// A sum of powers of signals.
#[inline(always)]
fn summed<S: Simd>(simd: S, items: &[Item], powers: &[f64], inner: usize) -> Complex<S> {
    let mut sum = Complex::zero(simd);
    for item in items {
        sum = sum.plus_scaled(simd, load(simd, powers, item.slot, inner), simd.splat_f64s(item.factor));
    }
    sum
}

/// Vectors of a block that are summed together.
const GROUP: usize = 4;

/// A column of a block: sums of each equation, multiplied by weights.
#[inline(always)]
fn weighed<S: Simd, const O: usize>(
    simd: S,
    items: &[Vec<Item>; O],
    powers: &[f64],
    weights: &[f64],
    row: &mut [f64],
) {
    let vectors = BLOCK / S::F64_LANES;
    let (powers, weights) = (S::as_simd_f64s(powers).0, S::as_simd_f64s(weights).0);
    let row = &mut S::as_mut_simd_f64s(row).0[..O * 2 * vectors];
    let mut empty = true;
    for equation in 0..O {
        if items[equation].is_empty() {
            continue;
        }
        for start in (0..vectors).step_by(GROUP) {
            let zero = simd.splat_f64s(0.0);
            let (mut re, mut im) = ([zero; GROUP], [zero; GROUP]);
            for item in &items[equation] {
                let (factor, begin) = (simd.splat_f64s(item.factor), item.slot * 2 * vectors + start);
                let (first, second) = (&powers[begin..][..GROUP], &powers[begin + vectors..][..GROUP]);
                for k in 0..GROUP {
                    re[k] = simd.mul_add_e_f64s(factor, first[k], re[k]);
                    im[k] = simd.mul_add_e_f64s(factor, second[k], im[k]);
                }
            }
            for a in 0..O {
                let (begin, to) = ((a * O + equation) * 2 * vectors + start, a * 2 * vectors + start);
                let (first, second) = (&weights[begin..][..GROUP], &weights[begin + vectors..][..GROUP]);
                let (mut x, mut y) = ([zero; GROUP], [zero; GROUP]);
                if !empty {
                    for k in 0..GROUP {
                        (x[k], y[k]) = (row[to + k], row[to + vectors + k]);
                    }
                }
                for k in 0..GROUP {
                    x[k] = simd.negate_mul_add_e_f64s(
                        second[k],
                        im[k],
                        simd.mul_add_e_f64s(first[k], re[k], x[k]),
                    );
                    y[k] = simd.mul_add_e_f64s(second[k], re[k], simd.mul_add_e_f64s(first[k], im[k], y[k]));
                }
                for k in 0..GROUP {
                    (row[to + k], row[to + vectors + k]) = (x[k], y[k]);
                }
            }
        }
        empty = false;
    }
    if empty {
        for value in row {
            *value = simd.splat_f64s(0.0);
        }
    }
}

/// A determinant of two rows and columns.
#[inline(always)]
fn minor<S: Simd, const O: usize>(
    simd: S,
    a: &[[Complex<S>; O]; O],
    r: [usize; 2],
    c: [usize; 2],
) -> Complex<S> {
    a[r[0]][c[0]].times(simd, a[r[1]][c[1]]).minus_product(simd, a[r[0]][c[1]], a[r[1]][c[0]])
}

/// Inverse of the loop's matrix, by cofactors.
#[inline(always)]
fn inverted<S: Simd, const O: usize>(simd: S, a: [[Complex<S>; O]; O]) -> [[Complex<S>; O]; O] {
    let mut found = a;
    let zero = Complex::zero(simd);
    match O {
        1 => found[0][0] = a[0][0].inverse(simd),
        2 => {
            let one = minor(simd, &a, [0, 1], [0, 1]).inverse(simd);
            found[0][0] = a[1][1].times(simd, one);
            found[1][1] = a[0][0].times(simd, one);
            found[0][1] = zero.minus_product(simd, a[0][1], one);
            found[1][0] = zero.minus_product(simd, a[1][0], one);
        }
        _ => {
            let others = [[1, 2], [0, 2], [0, 1]];
            let mut determinant = zero;
            for i in 0..3 {
                for j in 0..3 {
                    let value = minor(simd, &a, others[i], others[j]);
                    found[j][i] = if (i + j) % 2 == 0 { value } else { zero.minus(simd, value) };
                }
            }
            for j in 0..3 {
                determinant = determinant.plus_product(simd, a[0][j], found[j][0]);
            }
            let one = determinant.inverse(simd);
            for i in 0..3 {
                for j in 0..3 {
                    found[i][j] = found[i][j].times(simd, one);
                }
            }
            // The brake's torque is only in the last equation.
            if O == 4 {
                let by = a[3][3].inverse(simd);
                for j in 0..3 {
                    let mut sum = zero;
                    for k in 0..3 {
                        sum = sum.minus_product(simd, a[3][k], found[k][j]);
                    }
                    found[3][j] = sum.times(simd, by);
                    found[j][3] = zero;
                }
                found[3][3] = by;
            }
        }
    }
    found
}

#[inline(always)]
fn product<S: Simd, const O: usize>(
    simd: S,
    matrix: &[[Complex<S>; O]; O],
    vector: &[Complex<S>; O],
) -> [Complex<S>; O] {
    let mut found = *vector;
    for i in 0..O {
        let mut sum = matrix[i][0].times(simd, vector[0]);
        for j in 1..O {
            sum = sum.plus_product(simd, matrix[i][j], vector[j]);
        }
        found[i] = sum;
    }
    found
}

/// Residuals and the model's derivatives, [1 + W, O, 2, F], at all frequencies.
///
/// # Errors
/// [`crate::error::Error::Invalid`] for arrays of inconsistent lengths, [`crate::error::Error::Stopped`].
pub fn residuals(
    equations: &Equations,
    spectra: Spectra<'_>,
    late: &[Late<'_>],
    stop: &Stop,
) -> Result<Vec<f64>> {
    struct Kept {
        values: Vec<f64>,
        count: usize,
    }
    impl Sink for Kept {
        #[inline(always)]
        fn weigh<S: Simd, const O: usize>(&self, _: S, _: usize, outputs: Square<S, O>) -> Square<S, O> {
            outputs
        }
        #[inline(always)]
        fn take<S: Simd, const O: usize>(&mut self, _: S, first: usize, rows: &[f64]) {
            for (row, values) in rows.chunks_exact(BLOCK).zip(self.values.chunks_exact_mut(self.count)) {
                values[first..first + BLOCK].copy_from_slice(row);
            }
        }
    }
    spectra.require(late)?;
    let columns = 1 + equations.slopes.len();
    let mut kept = Kept {
        values: vec![0.0; columns * equations.outputs.len() * 2 * spectra.count],
        count: spectra.count,
    };
    each_block(equations, spectra, late, &mut kept, stop)?;
    Ok(kept.values)
}
