//! What the parameters add of themselves to the derivatives, piece by piece.
//!
//! A parameter adds a signal's series, in its own lane: the lane's mark, a one among zeros, times that series.

use pulp::Simd;

use crate::ship::parameters::at;

use super::model::{Jets, Model, Series, for_terms, is_flexible};
use super::outside::Over;
use super::slopes::{LANES, Pack, Slopes, get, packs};

/// Lanes of the parameters in a pack that add the same series: ones, or minus ones.
pub type Mark = Option<Pack>;

/// What the parameters add of themselves.
#[derive(Clone)]
pub struct Sources {
    pub marks: Vec<Marks>,
    wrt: Vec<usize>,
    /// Whether one moves the dead time in the loop.
    late: bool,
}

/// Of a pack, by what is added: to the shaft, or a flexible one's engine's end;
#[derive(Clone)]
pub struct Marks {
    /// the rate of the speed, the speed, the rack, a limit that holds the torque, the power by its exponent, the load;
    pub rate: Mark,
    pub speed: Mark,
    pub rack: Mark,
    pub top: Mark,
    pub by_exponent: Mark,
    pub load: Mark,
    /// to the lag and to what goes back into the governor;
    pub lag: Mark,
    pub k_p: Mark,
    pub k_i: Mark,
    pub k_d: Mark,
    /// to the feed, and at all times, before and after the dead time is over;
    pub s_u: Mark,
    pub t_set: Mark,
    pub late: Mark,
    pub before: Pack,
    pub after: Pack,
    /// to a flexible shaft's ends and spring.
    pub damping: Mark,
    pub tau_prop: Mark,
    pub tau_twist: Mark,
    pub zeta: Mark,
}

/// What a piece is fed, and its signals.
pub struct Given<'a> {
    pub jets: &'a Jets,
    pub open: bool,
    pub load: Series,
    /// By the proportional and the integral gain, the scale of the set point and its dead time, and the dead time in the loop.
    fed: [Series; 5],
}

/// Add a series by its mark.
#[inline(always)]
fn add<S: Simd, const T: usize>(simd: S, mark: &Mark, part: usize, series: &Series, to: &mut [S::f64s; T]) {
    if let Some(mark) = mark {
        let mark = get::<S>(mark, part);
        for_terms!(K of T => {
            to[K] = simd.mul_add_e_f64s(mark, simd.splat_f64s(series[K]), to[K]);
        });
    }
}

impl Sources {
    pub fn new(model: &Model, wrt: &[usize], set0: f64, load0: f64) -> Self {
        // A lag that begins is a dead time that begins.
        let lags = model.tau_act > 0.0;
        let is_late = |place: usize| place == at::T_D || (place == at::TAU_ACT && !lags);
        let [before, after] =
            [packs(wrt, |place| model.held_by(place)), packs(wrt, |place| model.base_by(place, set0, load0))];
        let all = |value: f64, is: &dyn Fn(usize) -> bool| marked(wrt, value, is);
        let of = |value: f64, place: usize| all(value, &move |other| other == place);
        let (rate, speed, rack) = (of(-1.0, at::TAU_N), of(1.0, at::G), of(1.0, at::V));
        let (by_exponent, load) = (of(-1.0, at::P), of(-1.0, at::LOAD_GAIN));
        let lag = all(-1.0, &|place| place == at::TAU_ACT && lags);
        let (k_p, k_i, k_d) = (of(1.0, at::K_P), of(1.0, at::K_I), of(1.0, at::K_D));
        let (s_u, t_set, late) = (of(1.0, at::S_U), of(-1.0, at::T_SET), all(1.0, &is_late));
        let (damping, tau_prop) = (of(-1.0, at::DAMPING), of(1.0, at::TAU_PROP));
        let (tau_twist, zeta) = (of(-1.0, at::TAU_TWIST), of(1.0, at::ZETA_TWIST));
        let marks = (0..before.len())
            .map(|pack| Marks {
                rate: rate[pack],
                speed: speed[pack],
                rack: rack[pack],
                top: None,
                by_exponent: by_exponent[pack],
                load: load[pack],
                lag: lag[pack],
                k_p: k_p[pack],
                k_i: k_i[pack],
                k_d: k_d[pack],
                s_u: s_u[pack],
                t_set: t_set[pack],
                late: late[pack],
                before: before[pack],
                after: after[pack],
                damping: damping[pack],
                tau_prop: tau_prop[pack],
                tau_twist: tau_twist[pack],
                zeta: zeta[pack],
            })
            .collect();
        Self { marks, wrt: wrt.to_vec(), late: wrt.iter().any(|&place| is_late(place)) }
    }

    /// The same while a limit holds the torque, at the parameters of these places: its level and its slope by the speed.
    pub fn held(&self, level: usize, slope: Option<usize>) -> Self {
        let mut held = self.clone();
        let of = |place: Option<usize>| marked(&self.wrt, 1.0, &move |other| Some(other) == place);
        for ((marks, top), speed) in held.marks.iter_mut().zip(of(Some(level))).zip(of(slope)) {
            (marks.top, marks.speed, marks.rack) = (top, speed, None);
        }
        held
    }

    /// What the parameters add over a piece, to which `back` comes back of the governor's.
    #[inline(always)]
    pub fn given<'a, const T: usize>(
        &self,
        model: &Model,
        jets: &'a Jets,
        on: &Over,
        back: Series,
    ) -> Given<'a> {
        let Jets { length, inverse, .. } = *jets;
        let Model { s_u, k_p, k_i, ahead, .. } = *model;
        let (set, error, summed) = (&on.set, &on.error, &on.summed);
        let mut fed = [[0.0; 8]; 5];
        fed[0][0] = error[0] - ahead * inverse * error[1];
        fed[0][1] = error[1];
        fed[1][0] = summed[0] - ahead * error[0];
        fed[1][1] = summed[1] - ahead * error[1];
        fed[1][2] = summed[2];
        fed[2][0] = k_p * set.value + k_i * on.integral;
        fed[2][1] = k_p * set.slope + k_i * length * set.value;
        fed[2][2] = k_i * length * 0.5 * set.slope;
        fed[3][0] = s_u * (k_p * set.slope * inverse + k_i * (set.value - on.set0));
        fed[3][1] = s_u * k_i * set.slope;
        if self.late {
            for k in 0..T - 1 {
                fed[4][k] = (k + 1) as f64 * inverse * back[k + 1];
            }
            fed[4][0] -= s_u * k_p * set.slope * inverse + k_i * error[0];
            fed[4][1] -= k_i * error[1];
        }
        let mut load = [0.0; 8];
        (load[0], load[1]) = (on.load[0], on.load[1]);
        Given { jets, open: on.open, load, fed }
    }

    /// To the shaft, or a flexible one's engine's end.
    #[inline(always)]
    pub fn shaft<S: Simd, const T: usize>(
        &self,
        simd: S,
        given: &Given<'_>,
        pack: usize,
        part: usize,
    ) -> [S::f64s; T] {
        let (marks, jets) = (&self.marks[pack], given.jets);
        let mut to = [simd.splat_f64s(0.0); T];
        add(simd, &marks.rate, part, &jets.rates, &mut to);
        add(simd, &marks.speed, part, &jets.n, &mut to);
        add(simd, &marks.rack, part, &jets.rack, &mut to);
        if let Some(top) = &marks.top {
            to[0] = simd.add_f64s(to[0], get::<S>(top, part));
        }
        if const { is_flexible(T) } {
            add(simd, &marks.tau_prop, part, &jets.rates, &mut to);
            add(simd, &marks.zeta, part, &negative(&jets.slip()), &mut to);
        } else {
            add(simd, &marks.by_exponent, part, &jets.by_exponent, &mut to);
            add(simd, &marks.damping, part, &jets.n, &mut to);
            add(simd, &marks.load, part, &given.load, &mut to);
        }
        to
    }

    /// To a flexible shaft's propeller.
    #[inline(always)]
    pub fn propeller<S: Simd, const T: usize>(
        &self,
        simd: S,
        given: &Given<'_>,
        pack: usize,
        part: usize,
    ) -> [S::f64s; T] {
        let (marks, jets) = (&self.marks[pack], given.jets);
        let mut to = [simd.splat_f64s(0.0); T];
        add(simd, &marks.by_exponent, part, &jets.by_exponent, &mut to);
        add(simd, &marks.damping, part, &jets.propeller, &mut to);
        add(simd, &marks.load, part, &given.load, &mut to);
        add(simd, &marks.tau_prop, part, &negative(&jets.rates_of::<T>(&jets.propeller)), &mut to);
        add(simd, &marks.zeta, part, &jets.slip(), &mut to);
        to
    }

    /// To a flexible shaft's spring.
    #[inline(always)]
    pub fn spring<S: Simd, const T: usize>(
        &self,
        simd: S,
        given: &Given<'_>,
        pack: usize,
        part: usize,
    ) -> [S::f64s; T] {
        let (marks, jets) = (&self.marks[pack], given.jets);
        let mut to = [simd.splat_f64s(0.0); T];
        add(simd, &marks.tau_twist, part, &jets.rates_of::<T>(&jets.spring), &mut to);
        to
    }

    /// To what goes back into the governor.
    #[inline(always)]
    pub fn back<S: Simd, const T: usize>(
        &self,
        simd: S,
        model: &Model,
        given: &Given<'_>,
        pack: usize,
        part: usize,
    ) -> [S::f64s; T] {
        let (marks, jets) = (&self.marks[pack], given.jets);
        let mut to = [simd.splat_f64s(0.0); T];
        if model.ahead > 0.0 {
            let (mut by_p, mut by_i) = (jets.n, jets.q);
            for k in 0..T {
                by_p[k] -= model.ahead * jets.rates[k];
                by_i[k] -= model.ahead * jets.n[k];
            }
            add(simd, &marks.k_p, part, &by_p, &mut to);
            add(simd, &marks.k_i, part, &by_i, &mut to);
        } else {
            add(simd, &marks.k_p, part, &jets.n, &mut to);
            add(simd, &marks.k_i, part, &jets.q, &mut to);
        }
        add(simd, &marks.k_d, part, &jets.rates, &mut to);
        to
    }

    /// To the feed of the rack.
    #[inline(always)]
    pub fn feed<S: Simd, const T: usize>(
        &self,
        simd: S,
        given: &Given<'_>,
        pack: usize,
        part: usize,
    ) -> [S::f64s; T] {
        let marks = &self.marks[pack];
        let mut to = [simd.splat_f64s(0.0); T];
        if given.open {
            to[0] = get::<S>(&marks.after, part);
            for (mark, series) in [(&marks.k_p, 0), (&marks.k_i, 1), (&marks.s_u, 2), (&marks.t_set, 3)] {
                if let Some(mark) = mark {
                    let mark = get::<S>(mark, part);
                    for k in 0..3 {
                        to[k] = simd.mul_add_e_f64s(mark, simd.splat_f64s(given.fed[series][k]), to[k]);
                    }
                }
            }
            add(simd, &marks.late, part, &given.fed[4], &mut to);
        } else {
            to[0] = get::<S>(&marks.before, part);
        }
        to
    }

    /// To the lag of the actuator.
    #[inline(always)]
    pub fn lag<S: Simd, const T: usize>(
        &self,
        simd: S,
        given: &Given<'_>,
        pack: usize,
        part: usize,
    ) -> [S::f64s; T] {
        let mut to = [simd.splat_f64s(0.0); T];
        add(simd, &self.marks[pack].lag, part, &given.jets.rates_of::<T>(&given.jets.rack), &mut to);
        to
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
            let (pack, lane) = (i / LANES, i % LANES);
            if model.tau_act > 0.0 {
                slopes[pack].rack.0[lane] += moved * fed / model.tau_act;
            } else {
                slopes[pack].n.0[lane] += moved * model.v * fed / model.inertia;
            }
        }
    }
}

/// Packs of the lanes of the parameters for which something holds; none where there are none.
fn marked(wrt: &[usize], value: f64, is: &dyn Fn(usize) -> bool) -> Vec<Mark> {
    packs(wrt, |place| if is(place) { value } else { 0.0 })
        .into_iter()
        .map(|pack| (pack != Pack::ZERO).then_some(pack))
        .collect()
}

/// A series with the other sign.
#[inline(always)]
fn negative(series: &Series) -> Series {
    series.map(|term| -term)
}
