//! The derivatives: one direction in each lane, series by series like the signals themselves.

use pulp::Simd;

use crate::ship::parameters::at;

use super::feed::Input;
use super::history::{Window, past};
use super::model::{Jets, Model, Power, Series, TERMS};

/// Lanes in a pack of directions.
pub const LANES: usize = 8;

/// What the parameters add of themselves, in rows of lanes: to the shaft, to what the rack is fed, to the lag, to what goes back.
pub struct Sources {
    shaft: Vec<f64>,
    feed: Vec<f64>,
    lag: Vec<f64>,
    back: Vec<f64>,
    /// What is added to the feed at all times, before and after the dead time is over.
    before: Vec<f64>,
    after: Vec<f64>,
    wrt: Vec<usize>,
    width: usize,
}

/// Derivatives of the state, a row each.
pub struct Slopes {
    pub n: Vec<f64>,
    pub q: Vec<f64>,
    pub rack: Vec<f64>,
    width: usize,
}

/// Series of the derivatives over a piece, in rows.
pub struct SlopeJets {
    pub n: Vec<f64>,
    pub q: Vec<f64>,
    pub rack: Vec<f64>,
}

impl SlopeJets {
    pub fn new(width: usize) -> Self {
        let room = || vec![0.0; (TERMS + 1) * width];
        Self { n: room(), q: room(), rack: room() }
    }
}

impl Slopes {
    pub fn new(model: &Model, wrt: &[usize], width: usize) -> Self {
        let row = |of: &dyn Fn(usize) -> f64| {
            let mut row = vec![0.0; width];
            for (value, &place) in row.iter_mut().zip(wrt) {
                *value = of(place);
            }
            row
        };
        Self {
            n: row(&|place| f64::from(u8::from(place == at::INITIAL_N))),
            q: vec![0.0; width],
            rack: row(&|place| model.held_by(place)),
            width,
        }
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
    pub fn new(model: &Model, wrt: &[usize], width: usize, set0: f64, load0: f64) -> Self {
        let row = |of: &dyn Fn(usize) -> f64| {
            let mut row = vec![0.0; width];
            for (value, &place) in row.iter_mut().zip(wrt) {
                *value = of(place);
            }
            row
        };
        let room = || vec![0.0; TERMS * width];
        Self {
            shaft: room(),
            feed: room(),
            lag: room(),
            back: room(),
            before: row(&|place| model.held_by(place)),
            after: row(&|place| model.base_by(place, set0, load0)),
            wrt: wrt.to_vec(),
            width,
        }
    }

    /// Lay down what the parameters add over a piece.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // an iterator that is not inlined would not be compiled for the machine's vectors
    pub fn lay(&mut self, model: &Model, jets: &Jets, on: &Circumstances<'_>) {
        let width = self.width;
        let Jets { length, inverse, n, q, rack, by_exponent, .. } = jets;
        let (s_u, k_p, k_i) = (model.s_u, model.k_p, model.k_i);
        let constant = if on.open { &self.after } else { &self.before };
        self.feed[..width].copy_from_slice(constant);
        for lane in 0..self.wrt.len() {
            let place = self.wrt[lane];
            let shaft = &mut self.shaft[lane..];
            let feed = &mut self.feed[lane..];
            let back = &mut self.back[lane..];
            match place {
                at::TAU_N => {
                    for k in 0..TERMS {
                        shaft[k * width] = -((k + 1) as f64 * inverse) * n[k + 1];
                    }
                }
                at::G => {
                    for k in 0..TERMS {
                        shaft[k * width] = n[k];
                    }
                }
                at::V => {
                    for k in 0..TERMS {
                        shaft[k * width] = rack[k];
                    }
                }
                at::P => {
                    for k in 0..TERMS {
                        shaft[k * width] = -by_exponent[k];
                    }
                }
                at::DAMPING => {
                    for k in 0..TERMS {
                        shaft[k * width] = -n[k];
                    }
                }
                at::LOAD_GAIN => {
                    shaft[0] = -on.load[0];
                    shaft[width] = -on.load[1];
                }
                at::K_P => {
                    for k in 0..TERMS {
                        back[k * width] = n[k];
                    }
                    if on.open {
                        feed[0] += on.error[0];
                        feed[width] = on.error[1];
                    }
                }
                at::K_I => {
                    for k in 0..TERMS {
                        back[k * width] = q[k];
                    }
                    if on.open {
                        feed[0] += on.summed[0];
                        feed[width] = on.summed[1];
                        feed[2 * width] = on.summed[2];
                    }
                }
                at::K_D => {
                    for k in 0..TERMS {
                        back[k * width] = (k + 1) as f64 * inverse * n[k + 1];
                    }
                }
                at::S_U if on.open => {
                    feed[0] += k_p * on.set.value + k_i * on.integral;
                    feed[width] = k_p * on.set.slope + k_i * length * on.set.value;
                    feed[2 * width] = k_i * length * 0.5 * on.set.slope;
                }
                at::T_SET if on.open => {
                    feed[0] = -s_u * (k_p * on.set.slope * inverse + k_i * (on.set.value - on.set0));
                    feed[width] = -s_u * k_i * on.set.slope;
                }
                at::TAU_ACT if model.tau_act > 0.0 => {
                    for k in 0..TERMS {
                        self.lag[k * width + lane] = -((k + 1) as f64 * inverse) * rack[k + 1];
                    }
                }
                // A lag that begins is a dead time that begins.
                at::T_D | at::TAU_ACT if on.open => {
                    for k in 0..TERMS - 1 {
                        feed[k * width] = (k + 1) as f64 * inverse * on.back[k + 1];
                    }
                    feed[0] -= s_u * k_p * on.set.slope * inverse + k_i * on.error[0];
                    feed[width] -= k_i * on.error[1];
                }
                _ => {}
            }
        }
    }

    /// The jump that a break, which parameters move, makes in the derivatives: `fed` is how much less the rack is fed behind it.
    pub fn jump(&self, model: &Model, moves: [f64; 2], fed: f64, slopes: &mut Slopes) {
        for (lane, &place) in self.wrt.iter().enumerate() {
            let moved = match place {
                at::T_D => moves[0],
                at::TAU_ACT if model.tau_act == 0.0 => moves[0],
                at::T_SET => moves[1],
                _ => continue,
            };
            if model.tau_act > 0.0 {
                slopes.rack[lane] += moved * fed / model.tau_act;
            } else {
                slopes.n[lane] += moved * model.v * fed / model.inertia;
            }
        }
    }

    /// Carry the derivatives over a piece, and lay down their series; `history` is where what goes back is kept, a row a term.
    #[inline(always)]
    #[allow(clippy::needless_range_loop, clippy::too_many_arguments)] // as above; and a struct of so many borrows would serve no one
    pub fn carry<S: Simd>(
        &self,
        simd: S,
        model: &Model,
        jets: &Jets,
        window: Option<&Window>,
        history: &mut [f64],
        place: usize,
        slopes: &mut Slopes,
        series: &mut SlopeJets,
    ) {
        let width = self.width;
        let registers = width / S::F64_LANES;
        let (delayed, lag) = (model.t_d > 0.0, model.tau_act > 0.0);
        let splat = |value: f64| simd.splat_f64s(value);
        let pace = jets.length / model.inertia;
        let acts = if lag { jets.length / model.tau_act } else { 0.0 };
        let (k_p, k_i, v) = (splat(model.k_p), splat(model.k_i), splat(model.v));
        let mut own = jets.slope;
        own[0] -= model.g - model.damping;
        for r in 0..registers {
            let row = |rows: &[f64], k: usize| S::as_simd_f64s(&rows[k * width..][..width]).0[r];
            let read = |slot: usize| {
                let rows = &history[slot * TERMS * width..][..TERMS * width];
                let mut terms = [splat(0.0); TERMS];
                for k in 0..TERMS {
                    terms[k] = row(rows, k);
                }
                terms
            };
            let mut fed = [splat(0.0); TERMS];
            match window {
                Some(window) => {
                    let back = past(simd, window, read);
                    for k in 0..TERMS {
                        fed[k] = simd.sub_f64s(row(&self.feed, k), back[k]);
                    }
                }
                None => {
                    for k in 0..TERMS {
                        fed[k] = row(&self.feed, k);
                    }
                }
            }
            let mut n = [splat(0.0); TERMS + 1];
            let mut q = [splat(0.0); TERMS + 1];
            let mut rack = [splat(0.0); TERMS + 1];
            n[0] = row(&slopes.n, 0);
            q[0] = row(&slopes.q, 0);
            rack[0] = row(&slopes.rack, 0);
            for k in 0..TERMS {
                let per_order = [1.0, 0.5, 1.0 / 3.0, 0.25, 0.2, 1.0 / 6.0][k];
                if !delayed {
                    fed[k] = simd.sub_f64s(
                        fed[k],
                        simd.mul_add_e_f64s(k_p, n[k], simd.mul_add_e_f64s(k_i, q[k], row(&self.back, k))),
                    );
                }
                if !lag {
                    rack[k] = fed[k];
                }
                let mut torque = simd.mul_add_e_f64s(v, rack[k], row(&self.shaft, k));
                for j in 0..=k {
                    torque = simd.mul_add_e_f64s(splat(-own[j]), n[k - j], torque);
                }
                n[k + 1] = simd.mul_f64s(splat(pace * per_order), torque);
                if !delayed && model.k_d != 0.0 {
                    let rate = simd.mul_f64s(splat(model.k_d * (k + 1) as f64 * jets.inverse), n[k + 1]);
                    fed[k] = simd.sub_f64s(fed[k], rate);
                    if !lag {
                        rack[k] = fed[k];
                    }
                }
                if lag {
                    let rate = simd.add_f64s(simd.sub_f64s(fed[k], rack[k]), row(&self.lag, k));
                    rack[k + 1] = simd.mul_f64s(splat(acts * per_order), rate);
                }
                q[k + 1] = simd.mul_f64s(splat(jets.length * per_order), n[k]);
            }
            if delayed {
                let rows = &mut history[place * TERMS * width..][..TERMS * width];
                for k in 0..TERMS {
                    let mut back =
                        simd.mul_add_e_f64s(k_p, n[k], simd.mul_add_e_f64s(k_i, q[k], row(&self.back, k)));
                    if model.k_d != 0.0 {
                        back = simd.mul_add_e_f64s(
                            splat(model.k_d * (k + 1) as f64 * jets.inverse),
                            n[k + 1],
                            back,
                        );
                    }
                    S::as_mut_simd_f64s(&mut rows[k * width..][..width]).0[r] = back;
                }
            }
            for (rows, terms) in [(&mut series.n, &n), (&mut series.q, &q), (&mut series.rack, &rack)] {
                for k in 0..=TERMS {
                    S::as_mut_simd_f64s(&mut rows[k * width..][..width]).0[r] = terms[k];
                }
            }
            for (state, terms) in [(&mut slopes.n, &n), (&mut slopes.q, &q), (&mut slopes.rack, &rack)] {
                let mut sum = terms[TERMS];
                for k in (0..TERMS).rev() {
                    sum = simd.add_f64s(sum, terms[k]);
                }
                S::as_mut_simd_f64s(state).0[r] = sum;
            }
        }
    }
}
