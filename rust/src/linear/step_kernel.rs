//! The inner loop: states of all lanes and their derivatives, step by step.

use pulp::{Simd, WithSimd};

use super::basis::{E, N as SPEED, SLOPE};
use super::discrete::{Step, Stepper};
use crate::instruction_set::arch;
use crate::subnormal::cut_all;

/// Number of segments of a record that are simulated at the same time, one in each SIMD lane.
pub const LANES: usize = 8;

/// One number of each lane.
pub type Pack = [f64; LANES];

/// States of all lanes, and their derivatives.
#[derive(Debug, Clone)]
pub struct States<const N: usize> {
    pub x: [Pack; N],
    pub by: Vec<[Pack; N]>,
}

/// Advance all lanes by some steps and lay down the rows of a basis.
pub struct Advance<'a, const N: usize, const J: usize, const T: usize> {
    pub stepper: &'a Stepper<N, J, T>,
    /// Packs of each input: step `k`, over `T - 2` samples, is fed the `T` from `k (T - 2)` on.
    pub inputs: &'a [Vec<Pack>; J],
    pub steps: usize,
    pub states: &'a mut States<N>,
    /// Signals wanted; their rows are `most` packs each, for the value and then for each direction.
    pub signals: &'a [usize],
    pub most: usize,
    pub rows: &'a mut [Pack],
}

impl<const N: usize, const J: usize, const T: usize> Advance<'_, N, J, T> {
    /// Run, with the widest vectors that this machine has, and cut what has decayed.
    pub fn run(mut self) {
        arch().dispatch(&mut self);
        let States { x, by } = self.states;
        cut_all(x.as_flattened_mut());
        cut_all(by.as_flattened_mut().as_flattened_mut());
    }
}

/// `sum` plus the vectors times their factors.
#[inline(always)]
fn add_products<S: Simd, const K: usize>(
    simd: S,
    mut sum: S::f64s,
    factors: &[f64; K],
    vectors: &[S::f64s; K],
) -> S::f64s {
    for i in 0..K {
        sum = simd.mul_add_e_f64s(simd.splat_f64s(factors[i]), vectors[i], sum);
    }
    sum
}

/// Add a matrix times a vector.
///
/// A column after the other: the rows' sums take turns, none waits for itself.
#[inline(always)]
#[allow(clippy::needless_range_loop)]
fn add_columns<S: Simd, const N: usize>(
    simd: S,
    sums: &mut [S::f64s; N],
    matrix: &[[f64; N]; N],
    vector: &[S::f64s; N],
) {
    for j in 0..N {
        for i in 0..N {
            sums[i] = simd.mul_add_e_f64s(simd.splat_f64s(matrix[i][j]), vector[j], sums[i]);
        }
    }
}

/// Add what the inputs feed through the taps of each row, in the same order.
#[inline(always)]
#[allow(clippy::needless_range_loop)]
fn add_feeds<S: Simd, const N: usize, const J: usize, const T: usize>(
    simd: S,
    sums: &mut [S::f64s; N],
    taps: &[[[f64; T]; J]; N],
    rho: &[[S::f64s; T]; J],
) {
    for j in 0..J {
        for t in 0..T {
            for i in 0..N {
                sums[i] = simd.mul_add_e_f64s(simd.splat_f64s(taps[i][j][t]), rho[j][t], sums[i]);
            }
        }
    }
}

/// What the inputs feed through those taps.
#[inline(always)]
fn feed<S: Simd, const J: usize, const T: usize>(
    simd: S,
    taps: &[[f64; T]; J],
    rho: &[[S::f64s; T]; J],
) -> S::f64s {
    let mut sum = simd.splat_f64s(0.0);
    for j in 0..J {
        sum = add_products(simd, sum, &taps[j], &rho[j]);
    }
    sum
}

/// A step's reading of a signal that is not a state itself; for a direction, without what its own states add.
#[inline(always)]
fn read<S: Simd, const N: usize, const J: usize, const T: usize>(
    simd: S,
    step: &Step<N, J, T>,
    signal: usize,
    x: &[S::f64s; N],
    rho: &[[S::f64s; T]; J],
) -> S::f64s {
    if signal == SLOPE {
        add_products(simd, feed(simd, &step.slope_feed, rho), &step.slope, x)
    } else {
        add_products(simd, simd.splat_f64s(0.0), &step.set_feed, &rho[0])
    }
}

/// The vectors of one part of the lanes.
#[inline(always)]
fn load<S: Simd, const K: usize>(simd: S, packs: &[Pack], part: usize) -> [S::f64s; K] {
    let mut vectors = [simd.splat_f64s(0.0); K];
    for i in 0..K {
        vectors[i] = S::as_simd_f64s(&packs[i]).0[part];
    }
    vectors
}

#[inline(always)]
fn store<S: Simd>(pack: &mut Pack, part: usize, vector: S::f64s) {
    S::as_mut_simd_f64s(pack).0[part] = vector;
}

impl<const N: usize, const J: usize, const T: usize> WithSimd for &mut Advance<'_, N, J, T> {
    type Output = ();

    // Plain indices: an iterator that is not inlined would not be compiled for the machine's vectors.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Advance { stepper, inputs, steps, states, signals, most, rows } = self;
        let (steps, most) = (*steps, *most);
        let step = &stepper.step;
        for part in 0..LANES / S::F64_LANES {
            let mut x = load::<S, N>(simd, &states.x, part);
            for k in 0..steps {
                let mut rho = [[simd.splat_f64s(0.0); T]; J];
                for j in 0..J {
                    rho[j] = load(simd, &inputs[j][k * (T - 2)..], part);
                }
                for position in 0..signals.len() {
                    let signal = match signals[position] {
                        SPEED => x[0],
                        E => x[1],
                        signal => read(simd, step, signal, &x, &rho),
                    };
                    store::<S>(&mut rows[position * most + k], part, signal);
                }
                for direction in 0..stepper.by.len() {
                    let by = &stepper.by[direction];
                    let states = &mut states.by[direction];
                    let s = load::<S, N>(simd, states, part);
                    for position in 0..signals.len() {
                        let signal = match signals[position] {
                            SPEED => s[0],
                            E => s[1],
                            SLOPE if !by.moves_feed => {
                                add_products(simd, simd.splat_f64s(0.0), &step.slope, &s)
                            }
                            SLOPE => add_products(simd, read(simd, by, SLOPE, &x, &rho), &step.slope, &s),
                            signal => read(simd, by, signal, &x, &rho),
                        };
                        store::<S>(
                            &mut rows[((1 + direction) * signals.len() + position) * most + k],
                            part,
                            signal,
                        );
                    }
                    let mut next = [simd.splat_f64s(0.0); N];
                    if by.moves_feed {
                        add_feeds(simd, &mut next, &by.taps, &rho);
                    }
                    if by.moves_phi {
                        add_columns(simd, &mut next, &by.phi, &x);
                    }
                    add_columns(simd, &mut next, &step.phi, &s);
                    for i in 0..N {
                        store::<S>(&mut states[i], part, next[i]);
                    }
                }
                let mut next = [simd.splat_f64s(0.0); N];
                add_feeds(simd, &mut next, &step.taps, &rho);
                add_columns(simd, &mut next, &step.phi, &x);
                x = next;
            }
            for i in 0..N {
                store::<S>(&mut states.x[i], part, x[i]);
            }
        }
    }
}
