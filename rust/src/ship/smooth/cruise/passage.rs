//! The signals over the sample intervals side by side.

use pulp::Simd;

use crate::ship::smooth::model::{Model, PER_ORDER, Series, TERMS, fma, for_terms};
use crate::ship::smooth::power::Power;
use crate::ship::smooth::slopes::{LANES, Pack, get, put};

use super::{Aboard, Cruise, Leg};

/// By so much the starts may miss what they follow. The next round, by Newton's rule, would leave the square of it.
const MISSED: f64 = 1e-11;

/// One piece of the sample intervals side by side: an interval in each lane.
#[derive(Debug, Clone)]
pub struct Passage {
    /// The set point's value and slope, the time since the dead time was first over and the integral of the set point.
    pub set: [Pack; 2],
    pub since: Pack,
    pub integral: Pack,
    pub load: [Pack; 2],
    /// What the governor's parameters and dead times add to the feed, as in [`super::super::sources::Given`].
    pub fed: [[Pack; TERMS]; 5],
    /// The signals' terms, and the slopes of the torque by the speed.
    pub rack: [Pack; TERMS],
    pub n: [Pack; TERMS + 1],
    pub q: [Pack; TERMS],
    pub rates: [Pack; TERMS],
    pub own: [Pack; TERMS],
    pub by_exponent: [Pack; TERMS],
    /// `N^p` and `1 / N` at the start.
    power: [Pack; 2],
    area: Pack,
}

impl Default for Passage {
    fn default() -> Self {
        let terms = [Pack::ZERO; TERMS];
        Self {
            set: [Pack::ZERO; 2],
            since: Pack::ZERO,
            integral: Pack::ZERO,
            load: [Pack::ZERO; 2],
            fed: [terms; 5],
            rack: terms,
            n: [Pack::ZERO; TERMS + 1],
            q: terms,
            rates: terms,
            own: terms,
            by_exponent: terms,
            power: [Pack::ZERO; 2],
            area: Pack::ZERO,
        }
    }
}

impl Passage {
    /// Add the terms of speed and rack by their weights.
    #[inline(always)]
    pub fn add<S: Simd, const T: usize>(
        &self,
        simd: S,
        speeds: &Series,
        racks: Option<&Series>,
        to: &mut Pack,
    ) {
        for part in 0..LANES / S::F64_LANES {
            let mut sum = get::<S>(to, part);
            for k in 0..=TERMS {
                sum = simd.mul_add_e_f64s(simd.splat_f64s(speeds[k]), get::<S>(&self.n[k], part), sum);
            }
            if let Some(racks) = racks {
                for k in 0..TERMS {
                    sum = simd.mul_add_e_f64s(simd.splat_f64s(racks[k]), get::<S>(&self.rack[k], part), sum);
                }
            }
            put::<S>(to, part, sum);
        }
    }

    /// The speed's terms from a start on; gives its end, and by how much that moves with the start.
    #[inline(always)]
    fn terms<S: Simd>(
        &mut self,
        simd: S,
        model: &Model,
        leg: &Leg,
        about: &Power,
        start: S::f64s,
        part: usize,
    ) -> [S::f64s; 2] {
        let splat = |value: f64| simd.splat_f64s(value);
        let times = |factor: f64, of: S::f64s| simd.mul_f64s(splat(factor), of);
        let (mul, fma) = (|a, b| simd.mul_f64s(a, b), |a, b, c| simd.mul_add_e_f64s(a, b, c));
        let speed = simd.add_f64s(start, splat(1.0));
        let [value, per_speed] = power::<S>(simd, model, about, speed);
        put::<S>(&mut self.power[0], part, value);
        put::<S>(&mut self.power[1], part, per_speed);
        let [b1, b2, b3, b4, _] = bends::<S>(simd, &model.binomial, value, per_speed);
        let pace = leg.length * model.per_inertia;
        let outside = model.g - model.damping;
        let linear = simd.sub_f64s(splat(pace * outside), times(pace, b1));
        let mut n = [start; TERMS + 1];
        for_terms!(K => {
            let mut known = times(model.v, get::<S>(&self.rack[K], part));
            if K < 2 {
                known = fma(splat(-model.load_gain), get::<S>(&self.load[K], part), known);
            }
            // What the terms before the last one add to the power's.
            let square = mul(n[1], n[1]);
            let bent = match K {
                2 => mul(b2, square),
                3 => mul(n[1], fma(b3, square, mul(times(2.0, b2), n[2]))),
                4 => {
                    let low = fma(times(2.0, n[1]), n[3], mul(n[2], n[2]));
                    fma(times(3.0, b3), mul(square, n[2]), fma(b4, mul(square, square), mul(b2, low)))
                }
                _ => splat(0.0),
            };
            n[K + 1] = if K == 0 {
                let own = fma(splat(outside), n[0], known);
                times(pace, simd.sub_f64s(own, simd.sub_f64s(value, splat(1.0))))
            } else {
                let known = times(pace * PER_ORDER[K], simd.sub_f64s(known, bent));
                fma(times(PER_ORDER[K], linear), n[K], known)
            };
        });
        for k in 0..=TERMS {
            put::<S>(&mut self.n[k], part, n[k]);
        }
        let high = simd.add_f64s(n[2], simd.add_f64s(simd.add_f64s(n[3], n[4]), n[5]));
        let end = simd.add_f64s(n[0], simd.add_f64s(n[1], high));
        // The exponential of the mean slope.
        let mean = fma(times(-pace, b2), simd.add_f64s(n[1], times(2.0 / 3.0, n[2])), linear);
        let third = fma(mean, splat(1.0 / 6.0), splat(0.5));
        [end, fma(mean, fma(mean, third, splat(1.0)), splat(1.0))]
    }

    /// All that follows from the speed's terms: the slopes of the torque, rates, and the area under the speed.
    #[inline(always)]
    fn finish<S: Simd, const EXPONENT: bool>(
        &mut self,
        simd: S,
        model: &Model,
        leg: &Leg,
        about: &Power,
        part: usize,
    ) {
        let splat = |value: f64| simd.splat_f64s(value);
        let times = |factor: f64, of: S::f64s| simd.mul_f64s(splat(factor), of);
        let (mul, fma) = (|a, b| simd.mul_f64s(a, b), |a, b, c| simd.mul_add_e_f64s(a, b, c));
        let (value, per_speed) = (get::<S>(&self.power[0], part), get::<S>(&self.power[1], part));
        let [b1, b2, b3, b4, b5] = bends::<S>(simd, &model.binomial, value, per_speed);
        let mut n = [value; TERMS + 1];
        for k in 0..=TERMS {
            n[k] = get::<S>(&self.n[k], part);
        }
        let square = mul(n[1], n[1]);
        let (cube, cross, fourth) = (mul(square, n[1]), mul(n[1], n[2]), mul(square, square));
        let bend = fma(times(2.0, n[1]), n[3], mul(n[2], n[2]));
        let (twice, thrice) = (times(2.0, b2), times(3.0, b3));
        let slope = [
            b1,
            mul(twice, n[1]),
            fma(twice, n[2], mul(thrice, square)),
            fma(twice, n[3], fma(times(2.0, thrice), cross, mul(times(4.0, b4), cube))),
            fma(
                twice,
                n[4],
                fma(thrice, bend, fma(times(12.0, b4), mul(square, n[2]), mul(times(5.0, b5), fourth))),
            ),
        ];
        put::<S>(&mut self.own[0], part, simd.sub_f64s(splat(model.g - model.damping), b1));
        for k in 1..TERMS {
            put::<S>(&mut self.own[k], part, simd.sub_f64s(splat(0.0), slope[k]));
        }
        let mut area = splat(0.0);
        for_terms!(K => {
            put::<S>(&mut self.rates[K], part, times((K + 1) as f64 * leg.inverse, n[K + 1]));
            area = fma(splat(leg.length * PER_ORDER[K]), n[K], area);
        });
        put::<S>(&mut self.area, part, area);
        if EXPONENT {
            let logarithm = logarithm::<S>(simd, about, simd.add_f64s(n[0], splat(1.0)));
            let moved = bends::<S>(simd, &model.binomial_by_exponent, value, per_speed);
            let c1 = fma(b1, logarithm, moved[0]);
            let c2 = fma(b2, logarithm, moved[1]);
            let c3 = fma(b3, logarithm, moved[2]);
            let c4 = fma(b4, logarithm, moved[3]);
            let fifth = fma(times(3.0, c3), mul(square, n[2]), mul(c4, fourth));
            let terms = [
                mul(value, logarithm),
                mul(c1, n[1]),
                fma(c1, n[2], mul(c2, square)),
                fma(c1, n[3], fma(times(2.0, c2), cross, mul(c3, cube))),
                fma(c1, n[4], fma(c2, bend, fifth)),
            ];
            for k in 0..TERMS {
                put::<S>(&mut self.by_exponent[k], part, terms[k]);
            }
        }
    }
}

/// Coefficients of the power about a speed, from the first order on.
#[inline(always)]
fn bends<S: Simd>(simd: S, of: &Series, value: S::f64s, per_speed: S::f64s) -> [S::f64s; 5] {
    let mut size = value;
    let mut bends = [value; 5];
    for k in 0..5 {
        size = simd.mul_f64s(size, per_speed);
        bends[k] = simd.mul_f64s(simd.splat_f64s(of[k + 1]), size);
    }
    bends
}

/// `N^p` and `1 / N`.
#[inline(always)]
fn power<S: Simd>(simd: S, model: &Model, about: &Power, speed: S::f64s) -> [S::f64s; 2] {
    let splat = |value: f64| simd.splat_f64s(value);
    let fma = |a, b, c| simd.mul_add_e_f64s(a, b, c);
    let x = simd.mul_f64s(simd.sub_f64s(speed, splat(about.speed)), splat(about.inverse));
    if about.inverse != 0.0 && simd.reduce_max_f64s(simd.abs_f64s(x)) < Power::NEAR {
        let b = &model.binomial;
        let square = simd.mul_f64s(x, x);
        let low = fma(square, fma(splat(b[3]), x, splat(b[2])), fma(splat(b[1]), x, splat(1.0)));
        let high = fma(square, fma(splat(b[7]), x, splat(b[6])), fma(splat(b[5]), x, splat(b[4])));
        let grown = fma(simd.mul_f64s(square, square), high, low);
        return [simd.mul_f64s(splat(about.value), grown), simd.div_f64s(splat(1.0), speed)];
    }
    let mut speeds = Pack::ZERO;
    put::<S>(&mut speeds, 0, speed);
    let (mut values, mut inverses) = (Pack::ZERO, Pack::ZERO);
    for lane in 0..S::F64_LANES {
        let power = Power::at(speeds.0[lane], model.p);
        (values.0[lane], inverses.0[lane]) = (power.value, power.inverse);
    }
    [get::<S>(&values, 0), get::<S>(&inverses, 0)]
}

/// The logarithm of the speed.
#[inline(always)]
fn logarithm<S: Simd>(simd: S, about: &Power, speed: S::f64s) -> S::f64s {
    let splat = |value: f64| simd.splat_f64s(value);
    let fma = |a, b, c| simd.mul_add_e_f64s(a, b, c);
    let x = simd.mul_f64s(simd.sub_f64s(speed, splat(about.speed)), splat(about.inverse));
    if about.inverse != 0.0 && simd.reduce_max_f64s(simd.abs_f64s(x)) < Power::NEAR {
        let square = simd.mul_f64s(x, x);
        let low = fma(square, fma(splat(-0.25), x, splat(1.0 / 3.0)), fma(splat(-0.5), x, splat(1.0)));
        let high =
            fma(square, fma(splat(-0.125), x, splat(1.0 / 7.0)), fma(splat(-1.0 / 6.0), x, splat(0.2)));
        return fma(x, fma(simd.mul_f64s(square, square), high, low), splat(about.logarithm));
    }
    let mut logarithms = Pack::ZERO;
    put::<S>(&mut logarithms, 0, speed);
    for lane in 0..S::F64_LANES {
        logarithms.0[lane] = logarithms.0[lane].abs().max(f64::MIN_POSITIVE).ln();
    }
    get::<S>(&logarithms, 0)
}

impl Cruise {
    /// About where each sample interval starts: with the power as a straight line, and the feed by its mean.
    #[inline(always)]
    fn guess<S: Simd>(&self, simd: S, model: &Model, n: f64, power: &Power) -> Pack {
        let slope = power.slope(model.p);
        let constant = slope * (power.speed - 1.0) - (power.value - 1.0);
        let (mut gain, mut starts) = (1.0, Pack::ZERO);
        for leg in 0..self.legs.len() {
            let (passage, pace) = (&self.passages[leg], self.legs[leg].length * model.per_inertia);
            let linear = pace * (model.g - model.damping - slope);
            let own = 1.0 + linear * (1.0 + 0.5 * linear);
            let driven = pace * (1.0 + 0.5 * linear);
            gain *= own;
            for part in 0..LANES / S::F64_LANES {
                let fma = |factor: f64, of, to| simd.mul_add_e_f64s(simd.splat_f64s(factor), of, to);
                let mut mean = simd.splat_f64s(constant);
                for_terms!(K => {
                    mean = fma(model.v * PER_ORDER[K], get::<S>(&passage.rack[K], part), mean);
                });
                for k in 0..2 {
                    mean = fma(-model.load_gain * PER_ORDER[k], get::<S>(&passage.load[k], part), mean);
                }
                let before = simd.mul_f64s(simd.splat_f64s(own), get::<S>(&starts, part));
                put::<S>(&mut starts, part, fma(driven, mean, before));
            }
        }
        let mut start = n;
        for lap in 0..LANES {
            let risen = starts.0[lap];
            starts.0[lap] = start;
            if lap + 1 < self.width {
                start = fma(gain, start, risen);
            }
        }
        starts
    }

    /// The signals over the sample intervals, from the state at their start.
    #[inline(always)]
    pub(super) fn pass<S: Simd, const EXPONENT: bool, const T: usize>(
        &mut self,
        simd: S,
        aboard: &mut Aboard<'_, '_, T>,
    ) {
        let (model, width) = (aboard.model, self.width);
        let mut starts = self.guess(simd, model, aboard.state.n, &aboard.state.power);
        let about = aboard.state.power.moved(1.0 + starts.0[width / 2], model);
        let (mut ends, mut gains) = (Pack::ZERO, Pack::ZERO);
        // Every round makes one interval more what it is from one after the other.
        for _ in 0..width {
            for part in 0..LANES / S::F64_LANES {
                let mut end = get::<S>(&starts, part);
                let mut gain = simd.splat_f64s(1.0);
                for leg in 0..self.legs.len() {
                    let on = &self.legs[leg];
                    let own;
                    [end, own] = self.passages[leg].terms::<S>(simd, model, on, &about, end, part);
                    gain = simd.mul_f64s(gain, own);
                }
                put::<S>(&mut ends, part, end);
                put::<S>(&mut gains, part, gain);
            }
            let (mut moved, mut most) = (0.0, 0.0_f64);
            for lap in 1..width {
                moved = fma(gains.0[lap - 1], moved, ends.0[lap - 1] - starts.0[lap]);
                starts.0[lap] += moved;
                most = most.max(f64::abs(moved));
            }
            ends.0[width - 1] += gains.0[width - 1] * moved;
            if most <= MISSED {
                break;
            }
        }
        let mut areas = Pack::ZERO;
        for leg in 0..self.legs.len() {
            let passage = &mut self.passages[leg];
            for part in 0..LANES / S::F64_LANES {
                passage.finish::<S, EXPONENT>(simd, model, &self.legs[leg], &about, part);
            }
            // Up to here, the area since the interval's start.
            for lane in 0..LANES {
                let area = passage.area.0[lane];
                passage.area.0[lane] = areas.0[lane];
                areas.0[lane] += area;
            }
        }
        let mut sums = Pack([aboard.state.q; LANES]);
        for lap in 1..LANES {
            sums.0[lap] = sums.0[lap - 1] + areas.0[lap - 1];
        }
        self.hand_back::<S>(simd, model, &sums);
        aboard.state.n = ends.0[width - 1];
        aboard.state.q = sums.0[width - 1] + areas.0[width - 1];
        aboard.state.power = about.moved(1.0 + aboard.state.n, model);
        self.past.pass(width);
    }

    /// The governor's sum, and what goes back into the governor.
    #[inline(always)]
    fn hand_back<S: Simd>(&mut self, simd: S, model: &Model, sums: &Pack) {
        for leg in 0..self.legs.len() {
            let (passage, length) = (&mut self.passages[leg], self.legs[leg].length);
            for part in 0..LANES / S::F64_LANES {
                for k in 0..TERMS {
                    let q = if k == 0 {
                        simd.add_f64s(get::<S>(sums, part), get::<S>(&passage.area, part))
                    } else {
                        let factor = simd.splat_f64s(length * PER_ORDER[k - 1]);
                        simd.mul_f64s(factor, get::<S>(&passage.n[k - 1], part))
                    };
                    put::<S>(&mut passage.q[k], part, q);
                    let n = simd.mul_f64s(simd.splat_f64s(model.k_p), get::<S>(&passage.n[k], part));
                    let back = simd.mul_add_e_f64s(simd.splat_f64s(model.k_i), q, n);
                    let lap = self.past.lap;
                    S::as_mut_simd_f64s(self.past.row(leg, k, lap)).0[part] = back;
                }
            }
        }
    }
}
