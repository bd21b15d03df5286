//! The derivatives over the sample intervals that were passed side by side, piece after piece.

use pulp::{Simd, WithSimd};

use crate::ship::smooth::model::{TERMS, for_terms};
use crate::ship::smooth::slopes::{LANES, Pack, get, put};
use crate::ship::smooth::sources::Mark;

use super::{Aboard, Cruise};

/// Add terms of one sample interval by a parameter's mark.
#[inline(always)]
fn add<S: Simd, const COUNT: usize>(
    simd: S,
    mark: &Mark,
    [part, lap]: [usize; 2],
    series: &[Pack],
    to: &mut [S::f64s; TERMS],
) {
    if let Some(mark) = mark {
        let mark = get::<S>(mark, part);
        for_terms!(K => {
            if K < COUNT {
                to[K] = simd.mul_add_e_f64s(mark, simd.splat_f64s(series[K].0[lap]), to[K]);
            }
        });
    }
}

/// Carry all derivatives, apart from what calls it: registers are scarce.
#[inline(never)]
pub fn apart<S: Simd, const T: usize>(simd: S, cruise: &Cruise, aboard: &mut Aboard<'_, '_, T>) {
    simd.vectorize(Carry { cruise, aboard });
}

struct Carry<'s, 'a, 'o, const T: usize> {
    cruise: &'s Cruise,
    aboard: &'s mut Aboard<'o, 'a, T>,
}

impl<const T: usize> WithSimd for Carry<'_, '_, '_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        self.cruise.carry::<S, T>(simd, self.aboard);
    }
}

impl Cruise {
    /// Carry all derivatives over the sample intervals.
    #[inline(always)]
    fn carry<S: Simd, const T: usize>(&self, simd: S, aboard: &mut Aboard<'_, '_, T>) {
        for pack in 0..aboard.derivatives.state.len() {
            for part in 0..LANES / S::F64_LANES {
                let slopes = &aboard.derivatives.state[pack];
                let mut state = [get::<S>(&slopes.n, part), get::<S>(&slopes.q, part)];
                for lap in 0..self.width {
                    for leg in 0..self.legs.len() {
                        state = self.carry_leg::<S, T>(simd, aboard, [pack, part], [lap, leg], state);
                    }
                }
                let slopes = &mut aboard.derivatives.state[pack];
                put::<S>(&mut slopes.n, part, state[0]);
                put::<S>(&mut slopes.q, part, state[1]);
            }
        }
    }

    /// Over one piece, from the derivatives of speed and sum at its start to those at its end.
    #[inline(always)]
    #[allow(clippy::absurd_extreme_comparisons)] // A term's number is a constant, and one of them the least.
    fn carry_leg<S: Simd, const T: usize>(
        &self,
        simd: S,
        aboard: &mut Aboard<'_, '_, T>,
        [pack, part]: [usize; 2],
        [lap, at]: [usize; 2],
        [start, sum]: [S::f64s; 2],
    ) -> [S::f64s; 2] {
        let (model, leg, passage) = (aboard.model, &self.legs[at], &self.passages[at]);
        let splat = |value: f64| simd.splat_f64s(value);
        let fma = |a, b, c| simd.mul_add_e_f64s(a, b, c);
        let fed = self.fed::<S, T>(simd, aboard, [pack, part], [lap, at]);
        let marks = &aboard.sources.marks[pack];
        let here = [part, lap];
        let mut shaft = [splat(0.0); TERMS];
        add::<S, TERMS>(simd, &marks.rate, here, &passage.rates, &mut shaft);
        add::<S, TERMS>(simd, &marks.speed, here, &passage.n, &mut shaft);
        add::<S, TERMS>(simd, &marks.rack, here, &passage.rack, &mut shaft);
        add::<S, TERMS>(simd, &marks.by_exponent, here, &passage.by_exponent, &mut shaft);
        add::<S, TERMS>(simd, &marks.damping, here, &passage.n, &mut shaft);
        add::<S, 2>(simd, &marks.load, here, &passage.load, &mut shaft);
        let mut back = [splat(0.0); TERMS];
        add::<S, TERMS>(simd, &marks.k_p, here, &passage.n, &mut back);
        add::<S, TERMS>(simd, &marks.k_i, here, &passage.q, &mut back);
        let (k_p, k_i, v) = (splat(model.k_p), splat(model.k_i), splat(model.v));
        let mut own = [splat(0.0); TERMS];
        for_terms!(K => {
            own[K] = splat(passage.own[K].0[lap]);
        });
        let (mut n, mut q) = ([start; TERMS + 1], [sum; TERMS + 1]);
        let place = (aboard.count + lap * self.legs.len() + at) & (aboard.outside.backs.len() - 1);
        let returned = &mut aboard.derivatives.backs[place * aboard.derivatives.state.len() + pack];
        for_terms!(K => {
            put::<S>(&mut returned[K], part, fma(k_p, n[K], fma(k_i, q[K], back[K])));
            let mut torque = fma(v, fed[K], shaft[K]);
            for_terms!(J => {
                if J <= K {
                    torque = fma(own[K - J], n[J], torque);
                }
            });
            n[K + 1] = simd.mul_f64s(splat(leg.paces[K]), torque);
            q[K + 1] = simd.mul_f64s(splat(leg.lengths[K]), n[K]);
        });
        self.lay::<S, T>(simd, aboard, (&n, &fed), [pack, part], [lap, at]);
        let mut ends = [n[0], q[0]];
        for_terms!(K => {
            ends = [simd.add_f64s(ends[0], n[K + 1]), simd.add_f64s(ends[1], q[K + 1])];
        });
        ends
    }

    /// What the rack is fed.
    #[inline(always)]
    #[allow(clippy::absurd_extreme_comparisons)] // A term's number is a constant, and one of them the least.
    fn fed<S: Simd, const T: usize>(
        &self,
        simd: S,
        aboard: &Aboard<'_, '_, T>,
        [pack, part]: [usize; 2],
        [lap, at]: [usize; 2],
    ) -> [S::f64s; TERMS] {
        let (leg, by) = (&self.legs[at], &self.passages[at].fed);
        let fma = |factor: f64, of, to| simd.mul_add_e_f64s(simd.splat_f64s(factor), of, to);
        let marks = &aboard.sources.marks[pack];
        let here = [part, lap];
        let mut fed = [simd.splat_f64s(0.0); TERMS];
        fed[0] = get::<S>(&marks.after, part);
        add::<S, 2>(simd, &marks.k_p, here, &by[0], &mut fed);
        add::<S, 3>(simd, &marks.k_i, here, &by[1], &mut fed);
        add::<S, 3>(simd, &marks.s_u, here, &by[2], &mut fed);
        add::<S, 2>(simd, &marks.t_set, here, &by[3], &mut fed);
        add::<S, 4>(simd, &marks.late, here, &by[4], &mut fed);
        let number = aboard.count + lap * self.legs.len() + at;
        let row = |pieces: usize| {
            let place = number.wrapping_sub(pieces) & (aboard.outside.backs.len() - 1);
            &aboard.derivatives.backs[place * aboard.derivatives.state.len() + pack]
        };
        let past = row(leg.first.pieces);
        if let Some(last) = &leg.last {
            let end = row(last.pieces);
            for_terms!(K => {
                // Where two pieces are joined, the first terms are those of the first.
                for j in if K < 3 { K } else { 0 }..TERMS {
                    fed[K] = fma(leg.first.less[K][j], get::<S>(&past[j], part), fed[K]);
                    if K >= 3 {
                        fed[K] = fma(last.less[K][j], get::<S>(&end[j], part), fed[K]);
                    }
                }
            });
        } else {
            for_terms!(K => {
                for j in K..TERMS {
                    fed[K] = fma(leg.first.less[K][j], get::<S>(&past[j], part), fed[K]);
                }
            });
        }
        fed
    }

    /// The derivatives of the samples that lie in a piece.
    #[inline(always)]
    fn lay<S: Simd, const T: usize>(
        &self,
        simd: S,
        aboard: &mut Aboard<'_, '_, T>,
        (n, fed): (&[S::f64s; TERMS + 1], &[S::f64s; TERMS]),
        [pack, part]: [usize; 2],
        [lap, at]: [usize; 2],
    ) {
        let fma = |factor: f64, of, to| simd.mul_add_e_f64s(simd.splat_f64s(factor), of, to);
        for point in 0..self.points.len() {
            let point = &self.points[point];
            if point.leg != at {
                continue;
            }
            let Some(slot) = aboard.emit.slot(point.output, point.channel, lap) else { continue };
            // The terms that are known last come last.
            let mut total = simd.mul_f64s(simd.splat_f64s(point.speeds[0]), n[0]);
            if let Some(racks) = &point.racks {
                for_terms!(K => {
                    total = fma(racks[K], fed[K], total);
                });
            }
            for own in 0..point.own.len() {
                let own = &point.own[own];
                total = fma(own.size.0[lap], get::<S>(&own.packs[pack], part), total);
            }
            for_terms!(K => {
                total = fma(point.speeds[K + 1], n[K + 1], total);
            });
            put::<S>(&mut aboard.emit.slopes[slot * aboard.derivatives.state.len() + pack], part, total);
        }
    }
}
