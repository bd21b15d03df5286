//! What the rack is fed over the sample intervals side by side.

use pulp::Simd;

use crate::ship::smooth::grid::{Piece, Time};
use crate::ship::smooth::model::{Series, TERMS, for_terms};
use crate::ship::smooth::slopes::{LANES, get, put};

use super::{Aboard, Cruise};

/// What went back into the governor, by piece of a sample interval, term and sample interval.
pub struct Past {
    values: Vec<f64>,
    /// Sample intervals of room, how many of them are read back, and the one that comes.
    room: usize,
    keep: usize,
    pub lap: usize,
}

impl Past {
    /// Out of a ring of all pieces up to one of that number.
    pub fn new(keep: usize, legs: usize, backs: &[Series], count: usize) -> Self {
        let room = keep + keep.max(64) + LANES;
        let mut past = Self { values: vec![0.0; legs * TERMS * room], room, keep, lap: keep };
        for lap in 0..keep {
            for leg in 0..legs {
                let back = &backs[count.wrapping_sub((keep - lap) * legs - leg) & (backs.len() - 1)];
                for k in 0..TERMS {
                    past.values[(leg * TERMS + k) * room + lap] = back[k];
                }
            }
        }
        past
    }

    /// Eight sample intervals of a term, from one on.
    #[inline(always)]
    pub fn row(&mut self, leg: usize, k: usize, lap: usize) -> &mut [f64] {
        &mut self.values[(leg * TERMS + k) * self.room + lap..][..LANES]
    }

    /// Go on by so many; what is read no more makes room.
    #[inline(always)]
    pub fn pass(&mut self, laps: usize) {
        self.lap += laps;
        if self.lap + LANES > self.room {
            let from = self.lap - self.keep;
            for row in self.values.chunks_exact_mut(self.room) {
                row.copy_within(from..from + self.keep, 0);
            }
            self.lap = self.keep;
        }
    }
}

impl Cruise {
    /// What the rack is fed, and what the governor's parameters add to it.
    #[inline(always)]
    pub(super) fn feed<S: Simd, const T: usize>(&mut self, simd: S, aboard: &mut Aboard<'_, '_, T>) {
        let dt = aboard.run.dt;
        let late = aboard.model.t_d;
        for lap in 0..self.width {
            for leg in 0..self.legs.len() {
                let (passage, piece) = (&mut self.passages[leg], &mut self.legs[leg].piece);
                let set = aboard.outside.set.over(piece);
                passage.set[0].0[lap] = set.value;
                passage.set[1].0[lap] = set.slope;
                let Piece { start: Time { whole, part }, .. } = *piece;
                let since = (whole as f64 + part) * dt - late;
                passage.since.0[lap] = since;
                passage.integral.0[lap] =
                    set.integral + aboard.model.t_set * (aboard.outside.set0 - 1.0) + since;
                if let Some(feed) = &mut aboard.outside.load {
                    let load = feed.over(piece);
                    passage.load[0].0[lap] = load.value;
                    passage.load[1].0[lap] = load.slope;
                }
                piece.start.whole += 1;
            }
        }
        for leg in 0..self.legs.len() {
            for part in 0..LANES / S::F64_LANES {
                self.feed_leg::<S, T>(simd, aboard, leg, part);
            }
        }
    }

    #[inline(always)]
    fn feed_leg<S: Simd, const T: usize>(
        &mut self,
        simd: S,
        aboard: &Aboard<'_, '_, T>,
        at: usize,
        part: usize,
    ) {
        let (model, leg, passage) = (aboard.model, &self.legs[at], &mut self.passages[at]);
        let splat = |value: f64| simd.splat_f64s(value);
        let times = |factor: f64, of: S::f64s| simd.mul_f64s(splat(factor), of);
        let fma = |factor: f64, of: S::f64s, to: S::f64s| simd.mul_add_e_f64s(splat(factor), of, to);
        let (k_p, k_i, s_u) = (model.k_p, model.k_i, model.s_u);
        let (value, slope) = (get::<S>(&passage.set[0], part), get::<S>(&passage.set[1], part));
        let (since, integral) = (get::<S>(&passage.since, part), get::<S>(&passage.integral, part));
        let mut less = [splat(0.0); TERMS];
        for past in [Some(&leg.first), leg.last.as_ref()].into_iter().flatten() {
            for j in 0..TERMS {
                let row = self.past.row(past.leg, j, self.past.lap - past.laps);
                let term = S::as_simd_f64s(row).0[part];
                for_terms!(K => {
                    less[K] = fma(past.less[K][j], term, less[K]);
                });
            }
        }
        let error = [fma(s_u, value, splat(-1.0)), times(s_u, slope)];
        let summed = [
            fma(s_u, simd.sub_f64s(integral, since), times(s_u - 1.0, since)),
            times(leg.length, error[0]),
            times(0.5 * leg.length, error[1]),
        ];
        let mut to = less;
        to[0] = fma(k_p, error[0], fma(k_i, summed[0], simd.add_f64s(less[0], splat(model.base))));
        to[1] = fma(k_p, error[1], fma(k_i, summed[1], less[1]));
        to[2] = fma(k_i, summed[2], less[2]);
        for_terms!(K => {
            put::<S>(&mut passage.rack[K], part, to[K]);
        });
        let mut fed = |series: usize, terms: [S::f64s; TERMS]| {
            for_terms!(K => {
                put::<S>(&mut passage.fed[series][K], part, terms[K]);
            });
        };
        let none = splat(0.0);
        fed(0, [error[0], error[1], none, none, none]);
        fed(1, [summed[0], summed[1], summed[2], none, none]);
        let risen = [
            fma(k_p, value, times(k_i, integral)),
            fma(k_p, slope, times(k_i * leg.length, value)),
            times(0.5 * k_i * leg.length, slope),
        ];
        fed(2, [risen[0], risen[1], risen[2], none, none]);
        let moved = simd.sub_f64s(value, splat(aboard.outside.set0));
        let later = [fma(s_u * k_p * leg.inverse, slope, times(s_u * k_i, moved)), times(s_u * k_i, slope)];
        fed(3, [later[0], later[1], none, none, none]);
        let mut by_dead_time = [none; TERMS];
        for k in 0..TERMS - 1 {
            by_dead_time[k] = times(-((k + 1) as f64) * leg.inverse, less[k + 1]);
        }
        let risen = fma(s_u * k_p * leg.inverse, slope, times(k_i, error[0]));
        by_dead_time[0] = simd.sub_f64s(by_dead_time[0], risen);
        by_dead_time[1] = fma(-k_i, error[1], by_dead_time[1]);
        fed(4, by_dead_time);
    }
}
