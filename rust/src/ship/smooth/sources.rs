//! What the parameters add of themselves to the derivatives, piece by piece.

use crate::ship::parameters::at;

use super::feed::Input;
use super::flexible::lay_ends;
use super::model::{Jets, Model, Series, is_flexible};
use super::slopes::{LANES, Pack, Rate, Slopes, packs};

/// What the parameters add of themselves, in rows of lanes: to the shaft, to what the rack is fed, to the lag, to what goes back;
/// to the propeller and the spring of a flexible shaft, whose engine's end is the shaft.
pub struct Sources<const T: usize> {
    pub shaft: Vec<Rate<T>>,
    pub feed: Vec<Rate<T>>,
    pub lag: Vec<Rate<T>>,
    pub back: Vec<Rate<T>>,
    pub propeller: Vec<Rate<T>>,
    pub spring: Vec<Rate<T>>,
    /// What is added to the feed at all times, before and after the dead time is over.
    before: Vec<Pack>,
    after: Vec<Pack>,
    wrt: Vec<usize>,
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

impl<const T: usize> Sources<T> {
    pub fn new(model: &Model, wrt: &[usize], set0: f64, load0: f64) -> Self {
        let room = || vec![[[0.0; LANES]; T]; wrt.len().div_ceil(LANES)];
        Self {
            shaft: room(),
            feed: room(),
            lag: room(),
            back: room(),
            propeller: if const { is_flexible(T) } { room() } else { Vec::new() },
            spring: if const { is_flexible(T) } { room() } else { Vec::new() },
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
            if const { is_flexible(T) } {
                let ends = [&mut self.shaft[pack], &mut self.propeller[pack], &mut self.spring[pack]];
                if lay_ends(ends, jets, on.load, place, lane) {
                    continue;
                }
            }
            let (shaft, feed) = (&mut self.shaft[pack], &mut self.feed[pack]);
            let (back, lag) = (&mut self.back[pack], &mut self.lag[pack]);
            match place {
                at::TAU_N => {
                    for k in 0..T {
                        shaft[k][lane] = -((k + 1) as f64 * inverse) * n[k + 1];
                    }
                }
                at::G => {
                    for k in 0..T {
                        shaft[k][lane] = n[k];
                    }
                }
                at::V => {
                    for k in 0..T {
                        shaft[k][lane] = rack[k];
                    }
                }
                at::P => {
                    for k in 0..T {
                        shaft[k][lane] = -by_exponent[k];
                    }
                }
                at::DAMPING => {
                    for k in 0..T {
                        shaft[k][lane] = -n[k];
                    }
                }
                at::LOAD_GAIN => {
                    shaft[0][lane] = -on.load[0];
                    shaft[1][lane] = -on.load[1];
                }
                at::K_P => {
                    for k in 0..T {
                        back[k][lane] = n[k] - ahead * (k + 1) as f64 * inverse * n[k + 1];
                    }
                    if on.open {
                        feed[0][lane] += on.error[0] - ahead * inverse * on.error[1];
                        feed[1][lane] = on.error[1];
                    }
                }
                at::K_I => {
                    for k in 0..T {
                        back[k][lane] = q[k] - ahead * n[k];
                    }
                    if on.open {
                        feed[0][lane] += on.summed[0] - ahead * on.error[0];
                        feed[1][lane] = on.summed[1] - ahead * on.error[1];
                        feed[2][lane] = on.summed[2];
                    }
                }
                at::K_D => {
                    for k in 0..T {
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
                    for k in 0..T {
                        lag[k][lane] = -((k + 1) as f64 * inverse) * rack[k + 1];
                    }
                }
                // A lag that begins is a dead time that begins.
                at::T_D | at::TAU_ACT if on.open => {
                    for k in 0..T - 1 {
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
}
