//! A flexible shaft: the engine's inertia and the propeller's swing against each other.
//!
//! With `n` and `m` the engine's and the propeller's speed and `s` the spring's torque, all less one, and `W = s + zeta (n - m)`:
//!
//! ```text
//! (tau_n - tau_prop) dn/dt = g n + v A - W        tau_prop dm/dt = W - (L(m) - 1)        tau_twist ds/dt = n - m
//! ```

use pulp::Simd;

use crate::ship::parameters::at;

use super::model::{FLEXIBLE_TERMS as TERMS, Jets, Model, PER_ORDER, Series, State, fma, for_terms, total};
use super::power::Power;
use super::slopes::{On, Pack, Results, get, packs, put, sum};
use super::sources::Sources;

/// Derivatives of the propeller's speed and the spring's torque at a piece's end.
#[derive(Debug, Clone, Copy)]
pub struct Ends {
    propeller: Pack,
    spring: Pack,
}

impl Ends {
    /// At the record's start, a pack each; none for a rigid shaft.
    pub fn start(model: &Model, wrt: &[usize], load0: f64) -> Vec<Self> {
        if model.tau_twist == 0.0 {
            return Vec::new();
        }
        let power = Power::at(1.0 + model.n0, model.p);
        let spring = |place| match place {
            at::INITIAL_N => power.slope(model.p) + model.damping,
            at::P => power.by_exponent(),
            at::DAMPING => model.n0,
            at::LOAD_GAIN => load0,
            _ => 0.0,
        };
        let speeds = packs(wrt, |place| f64::from(u8::from(place == at::INITIAL_N)));
        let both = speeds.into_iter().zip(packs(wrt, spring));
        both.map(|(propeller, spring)| Self { propeller, spring }).collect()
    }
}

/// The powers of a series, term by term, from `N (N^p)' = p N' N^p`.
struct Law {
    p: f64,
    power: Power,
    value: Series,
}

impl Law {
    #[inline(always)]
    fn new(power: Power, p: f64) -> Self {
        let mut value = [0.0; 8];
        value[0] = power.value;
        Self { p, power, value }
    }

    /// What the terms of the speed before the last one make of a term.
    #[inline(always)]
    fn before<const K: usize>(&self, m: &Series) -> f64 {
        let mut sum = 0.0;
        for j in 1..K {
            sum = fma(fma(self.p, j as f64, j as f64 - K as f64) * m[j], self.value[K - j], sum);
        }
        if K < 2 { 0.0 } else { sum * (self.power.inverse * PER_ORDER[K - 1]) }
    }

    /// The series of the slope by the speed.
    #[inline(always)]
    fn slope(&self, m: &Series) -> Series {
        let mut slope = [0.0; 8];
        for_terms!(K of TERMS => {
            slope[K] = self.power.inverse * (self.p * self.value[K] - product::<K>(m, &slope, 0.0));
        });
        slope
    }

    /// The series of the derivative by the exponent, `N^p ln N`.
    #[inline(always)]
    fn by_exponent(&self, m: &Series) -> Series {
        // The logarithm's rate, times what has passed, and the logarithm.
        let (mut rate, mut logarithm, mut found) = ([0.0; 8], [0.0; 8], [0.0; 8]);
        logarithm[0] = self.power.logarithm;
        for_terms!(K of TERMS => {
            if K != 0 {
                rate[K] = self.power.inverse * (K as f64 * m[K] - product::<K>(m, &rate, 0.0));
                logarithm[K] = rate[K] / K as f64;
            }
            found[K] = product::<K>(&self.value, &logarithm, self.value[0]);
        });
        found
    }
}

/// A term of the product of two series, the first with another constant.
#[inline(always)]
fn product<const K: usize>(a: &Series, b: &Series, constant: f64) -> f64 {
    let mut sum = constant * b[K];
    for j in 1..=K {
        sum = fma(a[j], b[K - j], sum);
    }
    sum
}

impl Model {
    /// The signals over a piece, as [`Self::jets`].
    #[inline(always)]
    pub fn flexible<const EXPONENT: bool, const DELAYED: bool, const LAG: bool>(
        &self,
        state: &State,
        [length, inverse]: [f64; 2],
        feed: &Series,
        load: [f64; 2],
        jets: &mut Jets,
    ) -> State {
        let mut law = Law::new(state.power, self.p);
        let (mut n, mut q, mut rack) = ([0.0; 8], [0.0; 8], [0.0; 8]);
        let (mut m, mut spring) = ([0.0; 8], [0.0; 8]);
        (n[0], q[0], rack[0], m[0], spring[0]) =
            (state.n, state.q, state.rack, state.propeller, state.spring);
        let paces = [length * self.per_inertia, length / self.tau_prop, length / self.tau_twist];
        let acts = if LAG { length / self.tau_act } else { 0.0 };
        let at_once = if !DELAYED && !LAG { self.v * self.near_p } else { 0.0 };
        let drawn = if DELAYED { 0.0 } else { self.k_i };
        let first = state.power.slope(self.p);
        let engine_own = self.g - at_once - self.zeta;
        let propeller_own = -(self.zeta + self.damping);
        for_terms!(K of TERMS => {
            let mut fed = fma(-drawn, q[K], feed[K]);
            let torque = if LAG { rack[K] } else { fed };
            // What a term adds to the next by itself comes last, so that the chain of terms is short.
            let mut known = fma(self.v, torque, -spring[K]);
            if K == 0 {
                known += self.top;
            }
            n[K + 1] = (paces[0] * PER_ORDER[K]) * fma(engine_own, n[K], fma(self.zeta, m[K], known));
            let before = law.before::<K>(&m);
            let loaded = if K < 2 { fma(-self.load_gain, load[K], spring[K]) } else { spring[K] };
            let (own, known) = if K == 0 {
                (propeller_own, loaded - (law.value[0] - 1.0))
            } else {
                law.value[K] = fma(first, m[K], before);
                (propeller_own - first, loaded - before)
            };
            m[K + 1] = (paces[1] * PER_ORDER[K]) * fma(own, m[K], fma(self.zeta, n[K], known));
            spring[K + 1] = (paces[2] * PER_ORDER[K]) * (n[K] - m[K]);
            if !DELAYED {
                fed -= fma(self.near_p, n[K], self.near_d * (K + 1) as f64 * n[K + 1] * inverse);
            }
            if LAG {
                rack[K + 1] = acts * PER_ORDER[K] * (fed - rack[K]);
            } else {
                rack[K] = fed;
            }
            q[K + 1] = length * PER_ORDER[K] * n[K];
        });
        jets.slope = law.slope(&m);
        if EXPONENT {
            jets.by_exponent = law.by_exponent(&m);
        }
        (jets.length, jets.inverse) = (length, inverse);
        (jets.n, jets.q, jets.rack, jets.propeller, jets.spring) = (n, q, rack, m, spring);
        jets.rates = jets.rates_of::<TERMS>(&n);
        let rack = if LAG { total(&rack, TERMS + 1) } else { 0.0 };
        let (n, q, spring) = (total(&n, TERMS + 1), total(&q, TERMS + 1), total(&spring, TERMS + 1));
        let propeller = total(&m, TERMS + 1);
        State { n, q, rack, propeller, spring, power: state.power.moved(1.0 + propeller, self) }
    }
}

impl Sources {
    /// One term after the other, of one register, as of a rigid shaft.
    #[inline(always)]
    pub fn bent<S: Simd, const T: usize, const DELAYED: bool, const MORE: bool>(
        &self,
        simd: S,
        on: On<'_>,
        part: usize,
        to: &mut Results<'_, '_, T>,
    ) {
        let On { model, given, pack, .. } = on;
        let jets = given.jets;
        let lag = MORE && model.tau_act > 0.0;
        let splat = |value: f64| simd.splat_f64s(value);
        let paces =
            [jets.length / model.inertia, jets.length / model.tau_prop, jets.length / model.tau_twist];
        let acts = if lag { jets.length / model.tau_act } else { 0.0 };
        let [k_p, k_d] = if DELAYED { [model.k_p, model.k_d] } else { model.near() };
        let (k_p, k_i, v) = (splat(k_p), splat(model.k_i), splat(model.v));
        let (engine_own, zeta) = (splat(model.g - model.zeta), splat(model.zeta));
        let mut own = [splat(0.0); TERMS];
        for j in 0..TERMS {
            own[j] = splat(-jets.slope[j]);
        }
        own[0] = splat(-(model.zeta + model.damping + jets.slope[0]));
        let mut fed = self.fed::<S, T>(simd, on, part, to);
        let shaft = self.shaft::<S, T>(simd, given, pack, part);
        let back = self.back::<S, T>(simd, model, given, pack, part);
        let loading = self.propeller::<S, T>(simd, given, pack, part);
        let winding = self.spring::<S, T>(simd, given, pack, part);
        let lagging = self.lag::<S, T>(simd, given, pack, part);
        let [mut n, mut q, mut rack, mut m, mut spring] = [[splat(0.0); TERMS + 1]; 5];
        let (slopes, ends) = (&mut to.slopes[pack], &mut to.ends[pack]);
        n[0] = get::<S>(&slopes.n, part);
        q[0] = get::<S>(&slopes.q, part);
        rack[0] = get::<S>(&slopes.rack, part);
        m[0] = get::<S>(&ends.propeller, part);
        spring[0] = get::<S>(&ends.spring, part);
        let mut returned = if DELAYED { to.history.get_mut(to.place + pack) } else { None };
        for_terms!(K of T => {
            let mut goes_back = simd.mul_add_e_f64s(k_p, n[K], simd.mul_add_e_f64s(k_i, q[K], back[K]));
            if !DELAYED {
                fed[K] = simd.sub_f64s(fed[K], goes_back);
            }
            if !lag {
                rack[K] = fed[K];
            }
            let mut torque = simd.sub_f64s(simd.mul_add_e_f64s(v, rack[K], shaft[K]), spring[K]);
            torque = simd.mul_add_e_f64s(zeta, m[K], simd.mul_add_e_f64s(engine_own, n[K], torque));
            n[K + 1] = simd.mul_f64s(splat(paces[0] * PER_ORDER[K]), torque);
            let mut driving = simd.add_f64s(spring[K], loading[K]);
            driving = simd.mul_add_e_f64s(zeta, n[K], driving);
            for j in (0..=K).rev() {
                driving = simd.mul_add_e_f64s(own[j], m[K - j], driving);
            }
            m[K + 1] = simd.mul_f64s(splat(paces[1] * PER_ORDER[K]), driving);
            let slip = simd.add_f64s(simd.sub_f64s(n[K], m[K]), winding[K]);
            spring[K + 1] = simd.mul_f64s(splat(paces[2] * PER_ORDER[K]), slip);
            if MORE && k_d != 0.0 {
                let rate = simd.mul_f64s(splat(k_d * (K + 1) as f64 * jets.inverse), n[K + 1]);
                goes_back = simd.add_f64s(goes_back, rate);
                if !DELAYED {
                    fed[K] = simd.sub_f64s(fed[K], rate);
                    if !lag {
                        rack[K] = fed[K];
                    }
                }
            }
            if lag {
                let rate = simd.add_f64s(simd.sub_f64s(fed[K], rack[K]), lagging[K]);
                rack[K + 1] = simd.mul_f64s(splat(acts * PER_ORDER[K]), rate);
            }
            q[K + 1] = simd.mul_f64s(splat(jets.length * PER_ORDER[K]), n[K]);
            if let Some(returned) = &mut returned {
                put::<S>(&mut returned[K], part, goes_back);
            }
        });
        put::<S>(&mut slopes.n, part, sum::<S, T>(simd, &n));
        put::<S>(&mut slopes.q, part, sum::<S, T>(simd, &q));
        put::<S>(&mut ends.propeller, part, sum::<S, T>(simd, &m));
        put::<S>(&mut ends.spring, part, sum::<S, T>(simd, &spring));
        if lag {
            put::<S>(&mut slopes.rack, part, sum::<S, T>(simd, &rack));
        }
        to.emit.lay::<S, T>(simd, [&n, &rack, &q], Some([&m, &spring]), pack, part);
    }
}
