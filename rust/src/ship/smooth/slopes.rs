//! The derivatives: one direction in each lane, series by series like the signals themselves.

use pulp::Simd;

use crate::ship::parameters::at;

use super::feed::Input;
use super::history::{Window, past};
use super::model::{Jets, Model, PER_ORDER, Power, Series, TERMS, for_terms};

/// Lanes in a pack of directions.
pub const LANES: usize = 8;

/// One number of each direction of a pack.
pub type Pack = [f64; LANES];

/// The terms of a signal that is a rate, and of one that is a state.
pub type Rate = [Pack; TERMS];
pub type Course = [Pack; TERMS + 1];

/// What the parameters add of themselves, in rows of lanes: to the shaft, to what the rack is fed, to the lag, to what goes back.
pub struct Sources {
    shaft: Vec<Rate>,
    feed: Vec<Rate>,
    lag: Vec<Rate>,
    back: Vec<Rate>,
    /// What is added to the feed at all times, before and after the dead time is over.
    before: Vec<Pack>,
    after: Vec<Pack>,
    wrt: Vec<usize>,
}

/// Derivatives of the state over a piece, and at its end.
#[derive(Debug, Clone, Copy)]
pub struct Slopes {
    pub n: Course,
    pub q: Course,
    pub rack: Course,
    n_end: Pack,
    q_end: Pack,
    rack_end: Pack,
}

/// Packs of what a parameter says, parameter after parameter.
pub fn packs(wrt: &[usize], of: impl Fn(usize) -> f64) -> Vec<Pack> {
    let pack = |places: &[usize]| {
        let mut pack = [0.0; LANES];
        for (value, &place) in pack.iter_mut().zip(places) {
            *value = of(place);
        }
        pack
    };
    wrt.chunks(LANES).map(pack).collect()
}

impl Slopes {
    /// At the record's start, a pack each.
    pub fn start(model: &Model, wrt: &[usize]) -> Vec<Self> {
        let n = packs(wrt, |place| f64::from(u8::from(place == at::INITIAL_N)));
        let rack = packs(wrt, |place| model.held_by(place));
        let nothing = [[0.0; LANES]; TERMS + 1];
        let both = n.into_iter().zip(rack);
        both.map(|(n_end, rack_end)| Self {
            n: nothing,
            q: nothing,
            rack: nothing,
            n_end,
            q_end: [0.0; LANES],
            rack_end,
        })
        .collect()
    }
}

impl Model {
    /// The derivative of the rack before the record.
    fn held_by(&self, place: usize) -> f64 {
        match place {
            at::INITIAL_F => 1.0 / self.v,
            at::V => -self.f0 / (self.v * self.v),
            _ => 0.0,
        }
    }

    /// The derivative of [`Model::base`].
    pub fn base_by(&self, place: usize, set0: f64, load0: f64) -> f64 {
        let (k_d, tau) = (self.k_d, self.tau);
        let speed = 1.0 + self.n0;
        let power = Power::at(speed, self.p);
        self.held_by(place)
            + match place {
                at::K_P => -(self.s_u * set0 - 1.0 - self.n0),
                at::S_U => -self.k_p * set0,
                at::INITIAL_N => self.k_p + k_d * (self.g - self.damping - power.slope(self.p)) / tau,
                at::INITIAL_F => k_d / tau,
                at::K_D => self.rate0,
                at::TAU_N => -k_d * self.rate0 / tau,
                at::G => k_d * self.n0 / tau,
                at::P => -k_d * power.by_exponent() / tau,
                at::DAMPING => -k_d * self.n0 / tau,
                at::LOAD_GAIN => -k_d * load0 / tau,
                _ => 0.0,
            }
    }
}

/// Where a piece stands: what it is fed, and what for.
pub struct Circumstances<'a> {
    pub open: bool,
    pub set: &'a Input,
    pub set0: f64,
    /// The integral of the set point since the record's start, at the piece's start [s].
    pub integral: f64,
    /// What is fed of the set point, and what came back a dead time ago.
    pub error: &'a Series,
    pub summed: &'a Series,
    pub back: &'a Series,
    pub load: [f64; 2],
}

impl Sources {
    pub fn new(model: &Model, wrt: &[usize], set0: f64, load0: f64) -> Self {
        let room = || vec![[[0.0; LANES]; TERMS]; wrt.len().div_ceil(LANES)];
        Self {
            shaft: room(),
            feed: room(),
            lag: room(),
            back: room(),
            before: packs(wrt, |place| model.held_by(place)),
            after: packs(wrt, |place| model.base_by(place, set0, load0)),
            wrt: wrt.to_vec(),
        }
    }

    /// Lay down what the parameters add over a piece.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // an iterator that is not inlined would not be compiled for the machine's vectors
    pub fn lay(&mut self, model: &Model, jets: &Jets, on: &Circumstances<'_>) {
        let Jets { length, inverse, n, q, rack, by_exponent, .. } = jets;
        let (s_u, k_p, k_i, ahead) = (model.s_u, model.k_p, model.k_i, model.ahead);
        let constant = if on.open { &self.after } else { &self.before };
        for (feed, constant) in self.feed.iter_mut().zip(constant) {
            feed[0] = *constant;
        }
        for (i, &place) in self.wrt.iter().enumerate() {
            let (pack, lane) = (i / LANES, i % LANES);
            let (shaft, feed) = (&mut self.shaft[pack], &mut self.feed[pack]);
            let (back, lag) = (&mut self.back[pack], &mut self.lag[pack]);
            match place {
                at::TAU_N => {
                    for k in 0..TERMS {
                        shaft[k][lane] = -((k + 1) as f64 * inverse) * n[k + 1];
                    }
                }
                at::G => {
                    for k in 0..TERMS {
                        shaft[k][lane] = n[k];
                    }
                }
                at::V => {
                    for k in 0..TERMS {
                        shaft[k][lane] = rack[k];
                    }
                }
                at::P => {
                    for k in 0..TERMS {
                        shaft[k][lane] = -by_exponent[k];
                    }
                }
                at::DAMPING => {
                    for k in 0..TERMS {
                        shaft[k][lane] = -n[k];
                    }
                }
                at::LOAD_GAIN => {
                    shaft[0][lane] = -on.load[0];
                    shaft[1][lane] = -on.load[1];
                }
                at::K_P => {
                    for k in 0..TERMS {
                        back[k][lane] = n[k] - ahead * (k + 1) as f64 * inverse * n[k + 1];
                    }
                    if on.open {
                        feed[0][lane] += on.error[0] - ahead * inverse * on.error[1];
                        feed[1][lane] = on.error[1];
                    }
                }
                at::K_I => {
                    for k in 0..TERMS {
                        back[k][lane] = q[k] - ahead * n[k];
                    }
                    if on.open {
                        feed[0][lane] += on.summed[0] - ahead * on.error[0];
                        feed[1][lane] = on.summed[1] - ahead * on.error[1];
                        feed[2][lane] = on.summed[2];
                    }
                }
                at::K_D => {
                    for k in 0..TERMS {
                        back[k][lane] = (k + 1) as f64 * inverse * n[k + 1];
                    }
                }
                at::S_U if on.open => {
                    feed[0][lane] += k_p * on.set.value + k_i * on.integral;
                    feed[1][lane] = k_p * on.set.slope + k_i * length * on.set.value;
                    feed[2][lane] = k_i * length * 0.5 * on.set.slope;
                }
                at::T_SET if on.open => {
                    feed[0][lane] = -s_u * (k_p * on.set.slope * inverse + k_i * (on.set.value - on.set0));
                    feed[1][lane] = -s_u * k_i * on.set.slope;
                }
                at::TAU_ACT if model.tau_act > 0.0 => {
                    for k in 0..TERMS {
                        lag[k][lane] = -((k + 1) as f64 * inverse) * rack[k + 1];
                    }
                }
                // A lag that begins is a dead time that begins.
                at::T_D | at::TAU_ACT if on.open => {
                    for k in 0..TERMS - 1 {
                        feed[k][lane] = (k + 1) as f64 * inverse * on.back[k + 1];
                    }
                    feed[0][lane] -= s_u * k_p * on.set.slope * inverse + k_i * on.error[0];
                    feed[1][lane] -= k_i * on.error[1];
                }
                _ => {}
            }
        }
    }

    /// The jump that a break, which parameters move, makes in the derivatives: `fed` is how much less the rack is fed behind it.
    pub fn jump(&self, model: &Model, moves: [f64; 2], fed: f64, slopes: &mut [Slopes]) {
        for (i, &place) in self.wrt.iter().enumerate() {
            let moved = match place {
                at::T_D => moves[0],
                at::TAU_ACT if model.tau_act == 0.0 => moves[0],
                at::T_SET => moves[1],
                _ => continue,
            };
            if model.tau_act > 0.0 {
                slopes[i / LANES].rack_end[i % LANES] += moved * fed / model.tau_act;
            } else {
                slopes[i / LANES].n_end[i % LANES] += moved * model.v * fed / model.inertia;
            }
        }
    }

    /// Carry the derivatives over a piece, and lay down their series; `history` is where what goes back is kept, so many packs
    /// a place.
    #[inline(always)]
    #[allow(clippy::too_many_arguments)] // a struct of so many borrows would serve no one
    pub fn carry<S: Simd>(
        &self,
        simd: S,
        model: &Model,
        jets: &Jets,
        window: Option<&Window>,
        history: &mut [Rate],
        place: usize,
        slopes: &mut [Slopes],
    ) {
        let packs = slopes.len();
        for (pack, slopes) in slopes.iter_mut().enumerate() {
            for part in 0..LANES / S::F64_LANES {
                let fed = self.fed(simd, pack, part, window, history, packs);
                let returned = history.get_mut(place * packs + pack);
                match (model.t_d > 0.0, model.tau_act > 0.0 || model.k_d != 0.0 || model.ahead > 0.0) {
                    (true, false) => {
                        self.terms::<S, true, false>(simd, model, jets, fed, pack, part, returned, slopes);
                    }
                    (true, true) => {
                        self.terms::<S, true, true>(simd, model, jets, fed, pack, part, returned, slopes);
                    }
                    (false, false) => {
                        self.terms::<S, false, false>(simd, model, jets, fed, pack, part, returned, slopes);
                    }
                    (false, true) => {
                        self.terms::<S, false, true>(simd, model, jets, fed, pack, part, returned, slopes);
                    }
                }
            }
        }
    }

    /// What the rack is fed from outside the piece.
    #[inline(always)]
    fn fed<S: Simd>(
        &self,
        simd: S,
        pack: usize,
        part: usize,
        window: Option<&Window>,
        history: &[Rate],
        packs: usize,
    ) -> [S::f64s; TERMS] {
        let mut fed = [simd.splat_f64s(0.0); TERMS];
        let feed = &self.feed[pack];
        for k in 0..TERMS {
            fed[k] = get::<S>(&feed[k], part);
        }
        if let Some(window) = window {
            let back = past(simd, window, |place| &history[place * packs + pack], part);
            for k in 0..TERMS {
                fed[k] = simd.sub_f64s(fed[k], back[k]);
            }
        }
        fed
    }

    /// One term after the other, of one register. `DELAYED`: a dead time in the loop; `MORE`: a lag or a derivative gain.
    #[inline(always)]
    #[allow(clippy::too_many_arguments)]
    fn terms<S: Simd, const DELAYED: bool, const MORE: bool>(
        &self,
        simd: S,
        model: &Model,
        jets: &Jets,
        mut fed: [S::f64s; TERMS],
        pack: usize,
        part: usize,
        mut returned: Option<&mut Rate>,
        slopes: &mut Slopes,
    ) {
        let lag = MORE && model.tau_act > 0.0;
        let splat = |value: f64| simd.splat_f64s(value);
        let pace = jets.length / model.inertia;
        let acts = if lag { jets.length / model.tau_act } else { 0.0 };
        // A dead time keeps its own gains; without one they are those that act at once.
        let [k_p, k_d] = if DELAYED { [model.k_p, model.k_d] } else { model.near() };
        let (k_p, k_i, v) = (splat(k_p), splat(model.k_i), splat(model.v));
        let mut own = [splat(0.0); TERMS];
        for j in 0..TERMS {
            own[j] = splat(-jets.slope[j]);
        }
        own[0] = splat(model.g - model.damping - jets.slope[0]);
        let (shaft, back, lagging) = (&self.shaft[pack], &self.back[pack], &self.lag[pack]);
        let mut n = [splat(0.0); TERMS + 1];
        let mut q = [splat(0.0); TERMS + 1];
        let mut rack = [splat(0.0); TERMS + 1];
        n[0] = get::<S>(&slopes.n_end, part);
        q[0] = get::<S>(&slopes.q_end, part);
        rack[0] = get::<S>(&slopes.rack_end, part);
        for_terms!(K => {
            let mut goes_back = simd.mul_add_e_f64s(k_p, n[K], simd.mul_add_e_f64s(k_i, q[K], get::<S>(&back[K], part)));
            if !DELAYED {
                fed[K] = simd.sub_f64s(fed[K], goes_back);
            }
            if !lag {
                rack[K] = fed[K];
            }
            let mut torque = simd.mul_add_e_f64s(v, rack[K], get::<S>(&shaft[K], part));
            for j in (0..=K).rev() {
                torque = simd.mul_add_e_f64s(own[j], n[K - j], torque);
            }
            n[K + 1] = simd.mul_f64s(splat(pace * PER_ORDER[K]), torque);
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
                let rate = simd.add_f64s(simd.sub_f64s(fed[K], rack[K]), get::<S>(&lagging[K], part));
                rack[K + 1] = simd.mul_f64s(splat(acts * PER_ORDER[K]), rate);
            }
            q[K + 1] = simd.mul_f64s(splat(jets.length * PER_ORDER[K]), n[K]);
            if DELAYED && let Some(returned) = &mut returned {
                put::<S>(&mut returned[K], part, goes_back);
            }
        });
        for k in 0..=TERMS {
            put::<S>(&mut slopes.n[k], part, n[k]);
            put::<S>(&mut slopes.q[k], part, q[k]);
            put::<S>(&mut slopes.rack[k], part, rack[k]);
        }
        put::<S>(&mut slopes.n_end, part, sum(simd, &n));
        put::<S>(&mut slopes.q_end, part, sum(simd, &q));
        if lag {
            put::<S>(&mut slopes.rack_end, part, sum(simd, &rack));
        }
    }
}

/// A part of a pack.
#[inline(always)]
pub fn get<S: Simd>(pack: &Pack, part: usize) -> S::f64s {
    S::as_simd_f64s(pack).0[part]
}

/// Set a part of a pack.
#[inline(always)]
pub fn put<S: Simd>(pack: &mut Pack, part: usize, value: S::f64s) {
    S::as_mut_simd_f64s(pack).0[part] = value;
}

#[inline(always)]
fn sum<S: Simd>(simd: S, terms: &[S::f64s; TERMS + 1]) -> S::f64s {
    let mut sum = terms[TERMS];
    for k in (0..TERMS).rev() {
        sum = simd.add_f64s(sum, terms[k]);
    }
    sum
}
