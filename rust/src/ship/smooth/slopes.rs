//! The derivatives: one direction in each lane, series by series like the signals themselves.

use pulp::Simd;

use crate::ship::parameters::at;

use super::flexible::Ends;
use super::history::{Window, past};
use super::model::{FLEXIBLE_TERMS, Jets, Model, PER_ORDER, TERMS, for_terms, is_flexible};
use super::power::Power;
use super::sources::Sources;

/// Lanes in a pack of directions.
pub const LANES: usize = 8;

/// One number of each direction of a pack.
pub type Pack = [f64; LANES];

/// The terms of a signal that is a rate, and of one that is a state, with room.
pub type Rate<const T: usize> = [Pack; T];
pub type Course = [Pack; FLEXIBLE_TERMS + 1];

/// Derivatives of the state over a piece, and at its end.
#[derive(Debug, Clone, Copy)]
pub struct Slopes {
    pub n: Course,
    pub q: Course,
    pub rack: Course,
    pub n_end: Pack,
    pub q_end: Pack,
    pub rack_end: Pack,
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
        let nothing = [[0.0; LANES]; FLEXIBLE_TERMS + 1];
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
    pub fn held_by(&self, place: usize) -> f64 {
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
                at::TAU_PROP if self.tau_twist > 0.0 => k_d * self.rate0 / tau,
                at::G => k_d * self.n0 / tau,
                at::P => -k_d * power.by_exponent() / tau,
                at::DAMPING => -k_d * self.n0 / tau,
                at::LOAD_GAIN => -k_d * load0 / tau,
                _ => 0.0,
            }
    }
}

impl<const T: usize> Sources<T> {
    /// Carry the derivatives over a piece, and lay down their series; `history` is where what goes back is kept, so many packs
    /// a place; `ends` are a flexible shaft's.
    #[inline(always)]
    #[allow(clippy::too_many_arguments)] // a struct of so many borrows would serve no one
    pub fn carry<S: Simd>(
        &self,
        simd: S,
        model: &Model,
        jets: &Jets,
        window: Option<&Window>,
        history: &mut [Rate<T>],
        place: usize,
        slopes: &mut [Slopes],
        ends: &mut [Ends],
    ) {
        let packs = slopes.len();
        for (pack, slopes) in slopes.iter_mut().enumerate() {
            for part in 0..LANES / S::F64_LANES {
                let fed = self.fed(simd, pack, part, window, history, packs);
                let returned = history.get_mut(place * packs + pack);
                if const { is_flexible(T) } {
                    self.bend(simd, model, (jets, fed, pack, part), returned, slopes, &mut ends[pack]);
                    continue;
                }
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
        history: &[Rate<T>],
        packs: usize,
    ) -> [S::f64s; T] {
        let mut fed = [simd.splat_f64s(0.0); T];
        let feed = &self.feed[pack];
        for k in 0..T {
            fed[k] = get::<S>(&feed[k], part);
        }
        if let Some(window) = window {
            let back = past(simd, window, |place| &history[place * packs + pack], part);
            for k in 0..T {
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
        mut fed: [S::f64s; T],
        pack: usize,
        part: usize,
        mut returned: Option<&mut Rate<T>>,
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
pub fn sum<S: Simd, const N: usize>(simd: S, terms: &[S::f64s; N]) -> S::f64s {
    let mut sum = terms[N - 1];
    for k in (0..N - 1).rev() {
        sum = simd.add_f64s(sum, terms[k]);
    }
    sum
}
