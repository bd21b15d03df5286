//! The derivatives: one direction in each lane, series by series like the signals themselves.

use pulp::{Simd, WithSimd};

use crate::ship::parameters::at;

use super::emit::Emit;
use super::flexible::Ends;
use super::history::{Window, past};
use super::model::{Model, PER_ORDER, TERMS, for_terms, is_flexible};
use super::power::Power;
use super::sources::{Given, Sources};

/// Lanes in a pack of directions.
pub const LANES: usize = 8;

/// One number of each direction of a pack, as wide as the widest vector and a line of the cache.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(64))]
pub struct Pack(pub [f64; LANES]);

impl Pack {
    pub const ZERO: Self = Self([0.0; LANES]);
}

/// The terms of a signal that is a rate.
pub type Rate<const T: usize> = [Pack; T];

/// The terms of a signal in registers, with room.
pub type Course<S> = [<S as Simd>::f64s; 8];

/// Derivatives of the state at a piece's end.
#[derive(Debug, Clone, Copy)]
pub struct Slopes {
    pub n: Pack,
    pub q: Pack,
    pub rack: Pack,
}

/// Packs of what a parameter says, parameter after parameter.
pub fn packs(wrt: &[usize], of: impl Fn(usize) -> f64) -> Vec<Pack> {
    let pack = |places: &[usize]| {
        let mut pack = Pack::ZERO;
        for (value, &place) in pack.0.iter_mut().zip(places) {
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
        n.into_iter().zip(rack).map(|(n, rack)| Self { n, q: Pack::ZERO, rack }).collect()
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

/// The derivatives on their way through a record: a pack of directions each.
pub struct Derivatives<const T: usize> {
    pub state: Vec<Slopes>,
    /// A flexible shaft's.
    pub ends: Vec<Ends>,
    /// What went back into the governor, so many packs a place.
    pub backs: Vec<Rate<T>>,
}

impl<const T: usize> Derivatives<T> {
    /// At a record's start, with so many places for the past.
    pub fn start(model: &Model, wrt: &[usize], places: usize, load0: f64) -> Self {
        let state = Slopes::start(model, wrt);
        let backs = vec![[Pack::ZERO; T]; places * state.len()];
        Self { state, ends: Ends::start(model, wrt, load0), backs }
    }

    /// How many packs there are.
    pub const fn packs(&self) -> usize {
        self.state.len()
    }

    /// Carry all packs over a piece.
    #[inline(always)]
    pub fn carry<S: Simd>(
        &mut self,
        simd: S,
        carry: Carry<S, T>,
        sources: &Sources,
        on: On<'_>,
        place: usize,
        emit: &mut Emit<'_>,
    ) {
        let packs = self.packs();
        let mut to = Results {
            slopes: &mut self.state,
            ends: &mut self.ends,
            history: &mut self.backs,
            place: place * packs,
            emit,
        };
        for pack in 0..packs {
            carry(simd, sources, On { pack, ..on }, &mut to);
        }
    }
}

/// Where the derivatives of a piece go: those of the state, those of what goes back into the governor, and the outputs.
pub struct Results<'a, 'b, const T: usize> {
    pub slopes: &'a mut [Slopes],
    /// A flexible shaft's.
    pub ends: &'a mut [Ends],
    /// So many packs a place.
    pub history: &'a mut [Rate<T>],
    pub place: usize,
    pub emit: &'a mut Emit<'b>,
}

/// Carries a pack of derivatives over a piece.
pub type Carry<S, const T: usize> = fn(S, &Sources, On<'_>, &mut Results<'_, '_, T>);

/// The way to carry a ship's derivatives. By address, since code in the loop over all pieces and packs would share its numbers
/// among the packs: more vectors than there are registers.
pub fn carry<S: Simd, const T: usize>(model: &Model) -> Carry<S, T> {
    match (model.t_d > 0.0, model.tau_act > 0.0 || model.k_d != 0.0 || model.ahead > 0.0) {
        (true, false) => carry_pack::<S, T, true, false>,
        (true, true) => carry_pack::<S, T, true, true>,
        (false, false) => carry_pack::<S, T, false, false>,
        (false, true) => carry_pack::<S, T, false, true>,
    }
}

fn carry_pack<S: Simd, const T: usize, const DELAYED: bool, const MORE: bool>(
    simd: S,
    sources: &Sources,
    on: On<'_>,
    to: &mut Results<'_, '_, T>,
) {
    simd.vectorize(CarryPack::<T, DELAYED, MORE> { sources, on, to });
}

struct CarryPack<'s, 'a, 'r, 'b, const T: usize, const DELAYED: bool, const MORE: bool> {
    sources: &'s Sources,
    on: On<'a>,
    to: &'s mut Results<'r, 'b, T>,
}

impl<const T: usize, const DELAYED: bool, const MORE: bool> WithSimd
    for CarryPack<'_, '_, '_, '_, T, DELAYED, MORE>
{
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { sources, on, to } = self;
        for part in 0..LANES / S::F64_LANES {
            if const { is_flexible(T) } {
                sources.bent::<S, T, DELAYED, MORE>(simd, on, part, to);
            } else {
                sources.terms::<S, T, DELAYED, MORE>(simd, on, part, to);
            }
        }
    }
}

impl Sources {
    /// What the rack is fed from outside the piece.
    #[inline(always)]
    pub fn fed<S: Simd, const T: usize>(
        &self,
        simd: S,
        On { given, window, pack, .. }: On<'_>,
        part: usize,
        to: &Results<'_, '_, T>,
    ) -> [S::f64s; T] {
        let mut fed = self.feed::<S, T>(simd, given, pack, part);
        if let Some(window) = window {
            let packs = to.slopes.len();
            let back = past(simd, window, |place| &to.history[place * packs + pack], part);
            for_terms!(K of T => {
                fed[K] = simd.sub_f64s(fed[K], back[K]);
            });
        }
        fed
    }

    /// One term after the other, of one register. `DELAYED`: a dead time in the loop; `MORE`: a lag or a derivative gain.
    #[inline(always)]
    fn terms<S: Simd, const T: usize, const DELAYED: bool, const MORE: bool>(
        &self,
        simd: S,
        on: On<'_>,
        part: usize,
        to: &mut Results<'_, '_, T>,
    ) {
        let (On { model, given, pack, .. }, jets) = (on, on.given.jets);
        let lag = MORE && model.tau_act > 0.0;
        let splat = |value: f64| simd.splat_f64s(value);
        let acts = if lag { jets.length / model.tau_act } else { 0.0 };
        // A dead time keeps its own gains; without one they are those that act at once.
        let [k_p, k_d] = if DELAYED { [model.k_p, model.k_d] } else { model.near() };
        let (k_p, k_i, v) = (splat(k_p), splat(model.k_i), splat(model.v));
        let mut own = [splat(0.0); TERMS];
        for j in 0..TERMS {
            own[j] = splat(-jets.slope[j]);
        }
        own[0] = splat(model.g - model.damping - jets.slope[0]);
        let mut fed = self.fed::<S, T>(simd, on, part, to);
        let shaft = self.shaft::<S, T>(simd, given, pack, part);
        let back = self.back::<S, T>(simd, model, given, pack, part);
        let lagging = self.lag::<S, T>(simd, given, pack, part);
        let [mut n, mut q, mut rack] = [[splat(0.0); 8]; 3];
        let slopes = &mut to.slopes[pack];
        n[0] = get::<S>(&slopes.n, part);
        q[0] = get::<S>(&slopes.q, part);
        rack[0] = get::<S>(&slopes.rack, part);
        let mut returned = if DELAYED { to.history.get_mut(to.place + pack) } else { None };
        for_terms!(K of TERMS => {
            let mut goes_back = simd.mul_add_e_f64s(k_p, n[K], simd.mul_add_e_f64s(k_i, q[K], back[K]));
            if !DELAYED {
                fed[K] = simd.sub_f64s(fed[K], goes_back);
            }
            if !lag {
                rack[K] = fed[K];
            }
            let mut torque = simd.mul_add_e_f64s(v, rack[K], shaft[K]);
            for j in (0..=K).rev() {
                torque = simd.mul_add_e_f64s(own[j], n[K - j], torque);
            }
            n[K + 1] = simd.mul_f64s(splat(jets.length * model.per_inertia * PER_ORDER[K]), torque);
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
        if lag {
            put::<S>(&mut slopes.rack, part, sum::<S, T>(simd, &rack));
        }
        to.emit.lay::<S, T>(simd, [&n, &rack, &q], None, pack, part);
    }
}

/// A pack of derivatives over a piece.
#[derive(Clone, Copy)]
pub struct On<'a> {
    pub model: &'a Model,
    pub given: &'a Given<'a>,
    pub window: Option<&'a Window>,
    pub pack: usize,
}

/// A part of a pack.
#[inline(always)]
pub fn get<S: Simd>(pack: &Pack, part: usize) -> S::f64s {
    S::as_simd_f64s(&pack.0).0[part]
}

/// Set a part of a pack.
#[inline(always)]
pub fn put<S: Simd>(pack: &mut Pack, part: usize, value: S::f64s) {
    S::as_mut_simd_f64s(&mut pack.0).0[part] = value;
}

/// A signal at the end of its piece, of so many terms of its rate.
#[inline(always)]
pub fn sum<S: Simd, const T: usize>(simd: S, terms: &Course<S>) -> S::f64s {
    // The last term, which is known last, comes last.
    let mut sum = terms[0];
    for_terms!(K of T => {
        sum = simd.add_f64s(sum, terms[K + 1]);
    });
    sum
}
