//! The equations on a piece of time, as series: each signal is a polynomial of the part of the piece that has passed.
//!
//! With `n = N - 1`, `Q` the integral of `n` and `f` what the governor is fed from outside the loop, the rack is fed
//! `f - Y(t - T_d)` with `Y = K_p n + K_i Q + K_d dn/dt`. Terms of one order after the other follow from the equations (the
//! method of Taylor series); those of `N^p` from `N (N^p)' = p N' N^p`.

use crate::ship::parameters::{Parameters, at};

use super::power::Power;

/// Terms of the rates. The speed has one more.
pub const TERMS: usize = 5;
/// Terms where the shaft is flexible: it swings, and a piece is a part of a swing.
pub const FLEXIBLE_TERMS: usize = 7;

/// Whether so many terms are those of a flexible shaft.
pub const fn is_flexible(terms: usize) -> bool {
    terms == FLEXIBLE_TERMS
}

/// Do something for every term. Written out, since a loop of that size is not, and its terms would then live in memory.
macro_rules! for_terms {
    (@ $k:ident $body:block $($number:literal)*) => {{
        $({
            const $k: usize = $number;
            $body
        })*
    }};
    ($k:ident => $body:block) => { for_terms!(@ $k $body 0 1 2 3 4) };
    // Of a number of terms that is a constant only where the function is used.
    ($k:ident of $terms:ident => $body:block) => {
        for_terms!(@ $k { if $k < $terms $body } 0 1 2 3 4 5 6)
    };
}
pub(super) use for_terms;

/// One over the number of a term and one.
pub const PER_ORDER: [f64; FLEXIBLE_TERMS] = [1.0, 0.5, 1.0 / 3.0, 0.25, 0.2, 1.0 / 6.0, 1.0 / 7.0];

/// Terms of a signal, and room.
pub type Series = [f64; 8];

/// Parameters, and what is made of them once.
#[derive(Debug, Clone, Copy)]
pub struct Model {
    /// The engine's inertia, and the propeller's along with it where the shaft is rigid [s].
    pub tau: f64,
    pub g: f64,
    pub v: f64,
    pub k_p: f64,
    pub k_i: f64,
    pub k_d: f64,
    pub p: f64,
    pub tau_prop: f64,
    pub tau_act: f64,
    pub damping: f64,
    pub load_gain: f64,
    /// The torque less one at the speed of one, of a limit that holds; 0 where none does.
    pub top: f64,
    /// The give of a flexible shaft and its damping; 0 where it is rigid.
    pub tau_twist: f64,
    pub zeta: f64,
    pub s_u: f64,
    pub s_m: f64,
    pub t_d: f64,
    pub t_set: f64,
    /// A dead time too short for pieces of its own: `X(t - ahead)` is `X - ahead dX/dt`, so the loop's gains are others [s].
    pub ahead: f64,
    pub near_p: f64,
    pub near_d: f64,
    pub n0: f64,
    pub f0: f64,
    /// What the rack is fed before the record.
    pub before: f64,
    /// The time constant that the shaft has where the governor's derivative term acts at once [s].
    pub inertia: f64,
    pub per_inertia: f64,
    /// The rate of the speed at the start [1/s].
    pub rate0: f64,
    /// What raises the command so that it starts as the rack stands.
    pub base: f64,
    /// Coefficients of `(1 + x)^p`, and their derivatives by `p`.
    pub binomial: Series,
    pub binomial_by_exponent: Series,
}

/// The state at the start of a piece, and its power law.
#[derive(Debug, Clone, Copy)]
pub struct State {
    pub n: f64,
    pub q: f64,
    pub rack: f64,
    /// The propeller's speed and the spring's torque less one, of a flexible shaft.
    pub propeller: f64,
    pub spring: f64,
    pub power: Power,
}

/// All signals over a piece.
#[derive(Debug, Clone, Copy, Default)]
pub struct Jets {
    /// Length of the piece [s], and its inverse.
    pub length: f64,
    pub inverse: f64,
    pub n: Series,
    pub q: Series,
    pub rack: Series,
    /// The rate of the speed [1/s].
    pub rates: Series,
    /// Of a flexible shaft, as in [`State`].
    pub propeller: Series,
    pub spring: Series,
    /// The slope of `N^p` by `N` and its derivative by `p`.
    pub slope: Series,
    pub by_exponent: Series,
}

impl Jets {
    /// The rate of a signal [1/s].
    #[inline(always)]
    pub fn rates_of<const T: usize>(&self, signal: &Series) -> Series {
        let mut rates = [0.0; 8];
        for k in 0..T {
            rates[k] = (k + 1) as f64 * self.inverse * signal[k + 1];
        }
        rates
    }

    /// How much faster a flexible shaft's engine turns than its propeller.
    #[inline(always)]
    pub fn slip(&self) -> Series {
        let mut slip = self.n;
        for (slip, propeller) in slip.iter_mut().zip(&self.propeller) {
            *slip -= propeller;
        }
        slip
    }
}

impl Model {
    /// Lags and dead times below `quick` [s] are taken to first order.
    pub fn new(parameters: &Parameters, set0: f64, load0: f64, quick: f64) -> Self {
        let of = |place| parameters.of(place);
        let (tau_twist, v, p, k_d) = (of(at::TAU_TWIST), of(at::V), of(at::P), of(at::K_D));
        let tau = of(at::TAU_N) - if tau_twist > 0.0 { of(at::TAU_PROP) } else { 0.0 };
        // A short lag acts as a dead time does.
        let lag = of(at::TAU_ACT);
        let (tau_act, late) = if lag < quick { (0.0, of(at::T_D) + lag) } else { (lag, of(at::T_D)) };
        let (t_d, ahead) = if late < quick { (0.0, late) } else { (late, 0.0) };
        let at_once = t_d == 0.0 && tau_act == 0.0;
        let near_d = k_d - ahead * of(at::K_P);
        let inertia = if at_once { tau + v * near_d } else { tau };
        let (mut binomial, mut by_exponent) = ([1.0; 8], [0.0; 8]);
        for m in 1..8 {
            let factor = (p - (m - 1) as f64) / m as f64;
            by_exponent[m] = by_exponent[m - 1] * factor + binomial[m - 1] / m as f64;
            binomial[m] = binomial[m - 1] * factor;
        }
        let (n0, f0) = (of(at::INITIAL_N) - 1.0, of(at::INITIAL_F));
        let drag = Power::at(1.0 + n0, p).value - 1.0 + of(at::DAMPING) * n0 + of(at::LOAD_GAIN) * load0;
        let rate0 = (of(at::G) * n0 + f0 - drag) / tau;
        let error0 = of(at::S_U) * set0 - 1.0 - n0;
        Self {
            tau,
            g: of(at::G),
            v,
            k_p: of(at::K_P),
            k_i: of(at::K_I),
            k_d,
            p,
            tau_prop: of(at::TAU_PROP),
            tau_act,
            damping: of(at::DAMPING),
            load_gain: of(at::LOAD_GAIN),
            top: 0.0,
            tau_twist,
            zeta: of(at::ZETA_TWIST),
            s_u: of(at::S_U),
            s_m: of(at::S_M),
            t_d,
            t_set: of(at::T_SET),
            ahead,
            near_p: of(at::K_P) - ahead * of(at::K_I),
            near_d,
            n0,
            f0,
            before: f0 / v,
            inertia,
            per_inertia: 1.0 / inertia,
            rate0,
            base: f0 / v - of(at::K_P) * error0 + k_d * rate0,
            binomial,
            binomial_by_exponent: by_exponent,
        }
    }

    /// The same ship while a limit holds its torque at `level + slope n`: the governor goes on, and moves nothing.
    pub fn held(&self, level: f64, slope: f64) -> Self {
        let per_inertia = 1.0 / self.tau;
        Self { top: level - 1.0, g: slope, v: 0.0, inertia: self.tau, per_inertia, ..*self }
    }

    pub fn start(&self, load0: f64) -> State {
        let power = Power::at(1.0 + self.n0, self.p);
        let spring = power.value - 1.0 + self.damping * self.n0 + self.load_gain * load0;
        State { n: self.n0, q: 0.0, rack: self.f0 / self.v, propeller: self.n0, spring, power }
    }

    /// The signals over a piece of so many seconds, given with its inverse, from a state on; `feed` is what the rack is fed from
    /// outside the piece, `load` the measured load. Gives the state at its end. `T` terms of the rates.
    #[inline(always)]
    pub fn jets<const EXPONENT: bool, const T: usize>(
        &self,
        state: &State,
        times: [f64; 2],
        feed: &Series,
        load: [f64; 2],
        jets: &mut Jets,
    ) -> State {
        // Those that most ships are, without a branch in the chain of terms.
        match (const { is_flexible(T) }, self.t_d > 0.0, self.tau_act > 0.0) {
            (false, true, false) => self.jets_of::<EXPONENT, true, false>(state, times, feed, load, jets),
            (false, false, false) => self.jets_of::<EXPONENT, false, false>(state, times, feed, load, jets),
            (false, true, true) => self.jets_of::<EXPONENT, true, true>(state, times, feed, load, jets),
            (false, false, true) => self.jets_of::<EXPONENT, false, true>(state, times, feed, load, jets),
            (true, true, false) => self.flexible::<EXPONENT, true, false>(state, times, feed, load, jets),
            (true, false, false) => self.flexible::<EXPONENT, false, false>(state, times, feed, load, jets),
            (true, true, true) => self.flexible::<EXPONENT, true, true>(state, times, feed, load, jets),
            (true, false, true) => self.flexible::<EXPONENT, false, true>(state, times, feed, load, jets),
        }
    }

    #[inline(always)]
    fn jets_of<const EXPONENT: bool, const DELAYED: bool, const LAG: bool>(
        &self,
        state: &State,
        [length, inverse]: [f64; 2],
        feed: &Series,
        load: [f64; 2],
        jets: &mut Jets,
    ) -> State {
        let Power { value, inverse: per_speed, .. } = state.power;
        // Coefficients of the power about the piece's start.
        let (per_2, value_1) = (per_speed * per_speed, value * per_speed);
        let value_3 = value_1 * per_2;
        let [_, b1, b2, b3, b4, ..] = self.binomial;
        let (b1, b2) = (b1 * value_1, b2 * (value * per_2));
        let (b3, b4) = (b3 * value_3, b4 * (value_3 * per_speed));
        let (mut n, mut q, mut rack) = ([0.0; 8], [0.0; 8], [0.0; 8]);
        (n[0], q[0], rack[0]) = (state.n, state.q, state.rack);
        let pace = length * self.per_inertia;
        let acts = if LAG { length / self.tau_act } else { 0.0 };
        // What a term adds to the next by itself; the rest of the next is known a term earlier, so that the chain is short.
        let at_once = if !DELAYED && !LAG { self.v * self.near_p } else { 0.0 };
        let outside = self.g - self.damping - at_once;
        let linear = pace * (outside - b1);
        let drawn = if DELAYED { 0.0 } else { self.k_i };
        for_terms!(K => {
            let fed = fma(-drawn, q[K], feed[K]);
            let torque = if LAG { rack[K] } else { fed };
            // What the terms before the last one add to the power's.
            let square = n[1] * n[1];
            let bent = match K {
                2 => b2 * square,
                3 => fma(b3, square * n[1], (2.0 * b2) * (n[1] * n[2])),
                4 => fma(3.0 * b3, square * n[2], fma(b4, square * square, b2 * fma(2.0 * n[1], n[3], n[2] * n[2]))),
                _ => 0.0,
            };
            let mut known = fma(self.v, torque, -bent);
            if K == 0 {
                known += self.top;
            }
            if K < 2 {
                known = fma(-self.load_gain, load[K], known);
            }
            n[K + 1] = if K == 0 {
                pace * (fma(outside, n[0], known) - (value - 1.0))
            } else {
                fma(linear * PER_ORDER[K], n[K], pace * PER_ORDER[K] * known)
            };
            let mut fed = fed;
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
        let ends = [sum(&n), sum(&q), if LAG { sum(&rack) } else { 0.0 }];
        self.bend::<EXPONENT>(&state.power, &n, jets);
        (jets.length, jets.inverse) = (length, inverse);
        (jets.n, jets.q, jets.rack) = (n, q, rack);
        for_terms!(K => {
            jets.rates[K] = (K + 1) as f64 * inverse * n[K + 1];
        });
        let power = state.power.moved(1.0 + ends[0], self);
        State { n: ends[0], q: ends[1], rack: ends[2], power, ..*state }
    }

    /// The series of the power's slopes by the speed and by the exponent, about the speed's.
    #[inline(always)]
    fn bend<const EXPONENT: bool>(&self, power: &Power, n: &Series, jets: &mut Jets) {
        let Power { value, inverse: per_speed, logarithm, .. } = *power;
        let (per_2, value_1) = (per_speed * per_speed, value * per_speed);
        let value_3 = value_1 * per_2;
        let [_, b1, b2, b3, b4, b5, ..] = self.binomial;
        let (b1, b2) = (b1 * value_1, b2 * (value * per_2));
        let (b3, b4, b5) = (b3 * value_3, b4 * (value_3 * per_speed), b5 * (value_3 * per_2));
        let square = n[1] * n[1];
        let cube = square * n[1];
        let (cross, fourth) = (n[1] * n[2], square * square);
        let bend = fma(2.0 * n[1], n[3], n[2] * n[2]);
        let slope = &mut jets.slope;
        slope[0] = b1;
        slope[1] = 2.0 * b2 * n[1];
        slope[2] = fma(2.0 * b2, n[2], 3.0 * b3 * square);
        slope[3] = fma(2.0 * b2, n[3], fma(6.0 * b3, cross, 4.0 * b4 * cube));
        slope[4] = fma(2.0 * b2, n[4], fma(3.0 * b3, bend, fma(12.0 * b4, square * n[2], 5.0 * b5 * fourth)));
        if EXPONENT {
            // The same with what the exponent makes of the coefficients.
            let [_, c1, c2, c3, c4, ..] = self.binomial_by_exponent;
            let c1 = fma(c1, value_1, b1 * logarithm);
            let c2 = fma(c2, value * per_2, b2 * logarithm);
            let c3 = fma(c3, value_3, b3 * logarithm);
            let c4 = fma(c4, value_3 * per_speed, b4 * logarithm);
            jets.by_exponent[0] = value * logarithm;
            jets.by_exponent[1] = c1 * n[1];
            jets.by_exponent[2] = fma(c1, n[2], c2 * square);
            jets.by_exponent[3] = fma(c1, n[3], fma(2.0 * c2, cross, c3 * cube));
            jets.by_exponent[4] = fma(c1, n[4], fma(c2, bend, fma(3.0 * c3, square * n[2], c4 * fourth)));
        }
    }

    /// The state behind a jump of what the rack is fed, by so much less, which comes [`Self::ahead`] later than it is reckoned.
    pub fn kicked(&self, state: &State, less: f64) -> State {
        let mut state = *state;
        if self.tau_act > 0.0 {
            state.rack += self.ahead * less / self.tau_act;
        } else {
            state.n += self.ahead * self.v * less / self.inertia;
            if self.tau_twist == 0.0 {
                state.power = state.power.moved(1.0 + state.n, self);
            }
        }
        state
    }

    /// The gains of the speed and of its rate that act within a piece.
    #[inline(always)]
    pub const fn near(&self) -> [f64; 2] {
        [self.near_p, self.near_d]
    }

    /// What goes back into the governor: `K_p n + K_i Q + K_d dn/dt`.
    #[inline(always)]
    pub fn fed_back<const T: usize>(&self, jets: &Jets) -> Series {
        let mut back = [0.0; 8];
        for k in 0..T {
            back[k] = self.k_p * jets.n[k]
                + self.k_i * jets.q[k]
                + self.k_d * (k + 1) as f64 * jets.n[k + 1] * jets.inverse;
        }
        back
    }
}

/// A multiply-add in one instruction, where the machine has it; what calls it is compiled for the machine's vectors.
#[inline(always)]
pub fn fma(a: f64, b: f64, c: f64) -> f64 {
    a.mul_add(b, c)
}

/// The same of a state's.
#[inline(always)]
fn sum(series: &Series) -> f64 {
    series[0] + (series[1] + (series[2] + ((series[3] + series[4]) + series[5])))
}

/// A series at the end of its piece.
#[inline(always)]
pub fn total(series: &Series, terms: usize) -> f64 {
    // Small terms first, two by two.
    let mut sum = 0.0;
    let mut k = terms;
    while k >= 2 {
        sum += series[k - 1] + series[k - 2];
        k -= 2;
    }
    if k == 1 { sum + series[0] } else { sum }
}
