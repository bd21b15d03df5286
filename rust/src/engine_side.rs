//! Effect of rate and torque limits on the engine, simulated without the shaft from measured set point and speed.
//!
//! ```text
//! T_f dS/dt = N - S    e(t) = u(t - T_set) + u_0 - S - droop X    X = K_p e + K_i I - K_d dS/dt    dI/dt = e
//! tau_act dF/dt = X(t - T_d) - F      A follows as F does, -rate_down <= dA/dt <= rate
//! tau_eng dB/dt = g (N - 1) + A - B                  M = min(1 + B, M_max)
//! ```
//!
//! The simulated torque does not act on the measured speed, so a limit is a clamp on a known signal. The integral of a
//! measured error drifts; the difference between the measured torque and `M` corrects it slowly. The governor's hold acts
//! as the mean of two delays around `T_d`, as in the ship's stepper.

use std::borrow::Cow;
use std::fmt::Debug;

use crate::error::{Result, require};
use crate::finite::all_finite;
use crate::stepper::{Lag, Pace, paced, softly_within};
use crate::stop::{CHECK_EVERY, Stop};

/// Names of the parameters: `ahead` is the inertia between engine and gauge [s], `s_M` the scale of the torque reading, and
/// `leads` the rate at which the measured torque corrects the integral [1/s].
pub const PARAMETERS: [&str; 21] = [
    "g",
    "vK_p",
    "vK_i",
    "vK_d",
    "T_d",
    "T_set",
    "T_s",
    "tau_act",
    "rate",
    "rate_down",
    "M_max",
    "M_soft",
    "u_0",
    "T_M",
    "T_n",
    "s_M",
    "ahead",
    "leads",
    "T_f",
    "tau_eng",
    "droop",
];

/// Deviations from the operating point, one value per sample.
#[derive(Debug, Clone, Copy)]
pub struct Measured<'a> {
    /// Set point of the governor.
    pub set_point: &'a [f64],
    /// Engine speed.
    pub speed: &'a [f64],
    /// Measured torque nearest to the engine.
    pub torque: &'a [f64],
    /// Sample time [s].
    pub every: f64,
}

/// Torque that limits remove from the engine, and the rack's share of it, at each sample.
///
/// # Errors
/// [`crate::error::Error::Invalid`] for signals of different lengths, samples that are not finite, or an invalid step, lag,
/// rate, rounding or scale; [`crate::error::Error::Stopped`] after a request.
#[allow(clippy::too_many_lines, clippy::float_cmp)] // What is off is off exactly.
pub fn taken_by_limits(
    data: Measured<'_>,
    parameters: &[f64; PARAMETERS.len()],
    stop: &Stop,
) -> Result<[Vec<f64>; 2]> {
    // long: one pass over the samples, in which each line of code needs the results of earlier lines
    let [
        g,
        k_p,
        k_i,
        k_d,
        dead,
        late,
        period,
        lag,
        rate,
        rate_down,
        highest,
        softness,
        offset,
        torque_late,
        speed_late,
        scale,
        ahead,
        leads,
        filter,
        charge,
        droop,
    ] = *parameters;
    // The droop feeds the command back to the set point: it reduces all gains by one factor and makes the integral decay.
    let less = 1.0 / (1.0 + droop * k_p);
    let (k_p, k_i, k_d) = (k_p * less, k_i * less, k_d * less);
    let half_fade = 0.5 * data.every * droop * k_i;
    let samples = data.speed.len();
    require(data.set_point.len() == samples && data.torque.len() == samples, || {
        "found set point, speed and torque of different lengths, expected one".to_owned()
    })?;
    require(all_finite(data.set_point) && all_finite(data.speed) && all_finite(data.torque), || {
        "found samples that are not finite, expected numbers".to_owned()
    })?;
    require(
        data.every > 0.0
            && lag >= 0.0
            && filter >= 0.0
            && charge >= 0.0
            && rate > 0.0
            && rate_down > 0.0
            && softness >= 0.0
            && droop >= 0.0
            && scale > 0.0,
        || "found a step, lag, rate, rounding, droop or scale below zero, expected them above".to_owned(),
    )?;
    let h = data.every;
    let apart = period / 12.0_f64.sqrt();
    let seen = Pair::new((dead - speed_late) / h, apart / h);
    let asked = Pair::new((dead + late) / h, apart / h);
    let read = Taps::new(-torque_late / h);
    let half_rate = 0.5 / h;
    let pace = Pace { lag, up: rate, down: -rate_down };
    let stays = if lag > 0.0 { (-h / lag).exp() } else { 0.0 };
    let led = leads * h;
    let within = |slope: f64, over: f64| (-rate_down * over..=rate * over).contains(&slope);
    let filtered = filtered(data.speed, filter / h);
    let charged = Lag::new(charge, h);
    let mut found = [Vec::with_capacity(samples), Vec::with_capacity(samples)];
    let (mut sum, mut before, mut commanded, mut free, mut rack) = (0.0, 0.0, 0.0, 0.0, 0.0);
    // Torque without the torque limit, and torque that the rack's rate limit removes; each with its input at the last
    // sample.
    let (mut burnt, mut taken) = ([0.0; 2], [0.0; 2]);
    for k in 0..samples {
        if k % CHECK_EVERY == 0 {
            stop.check()?;
        }
        let speed = data.speed[k];
        let slope = (data.speed[(k + 1).min(samples - 1)] - data.speed[k.saturating_sub(1)]) * half_rate;
        let engine = (1.0 + read.of(data.torque, k)) / scale - 1.0 + ahead * slope;
        let error = asked.of(data.set_point, k) + offset - seen.of(&filtered, k);
        let mut command = k_p * error;
        if k_d != 0.0 {
            command -=
                k_d * half_rate * (seen.of(&filtered, k + 1) - seen.of(&filtered, k.saturating_sub(1)));
        }
        if k == 0 {
            sum = engine - g * speed - command;
            free = command + sum;
            rack = free;
        } else {
            sum += k_i * 0.5 * (error + before) * h;
            sum -= half_fade * (commanded + command + sum) / (1.0 + half_fade);
        }
        command += sum;
        if k > 0 {
            let rise = (command - commanded) / h;
            let gap = commanded - rack;
            // Over a step the rack's slope changes from gap / lag to the command's slope. If both are within the limits,
            // none acts.
            rack = if lag > 0.0 && within(gap, lag) && within(rise, 1.0) {
                command - rise * lag + (rise * lag - gap) * stays
            } else {
                paced(rack, commanded, rise, h, pace)[0]
            };
            free = command - rise * lag + (free - commanded + rise * lag) * stays;
        }
        let fed = [g * speed + rack, rack - free];
        if k == 0 || charge == 0.0 {
            (burnt, taken) = ([fed[0]; 2], [fed[1]; 2]);
        } else {
            for (state, now) in [&mut burnt, &mut taken].into_iter().zip(fed) {
                *state = [charged.over(state[0], now, 0.5 * (state[1] + now)), now];
            }
        }
        let whole = 1.0 + burnt[0];
        let torque =
            if softness > 0.0 { softly_within(whole, highest, softness).0 } else { whole.min(highest) };
        found[0].push(torque - whole + taken[0]);
        found[1].push(rack - free);
        let beyond = (1.0 + engine - torque) * led;
        sum += beyond;
        command += beyond;
        burnt = burnt.map(|value| value + beyond);
        if rate.min(rate_down).is_finite() {
            rack += beyond;
            free += beyond;
        }
        (before, commanded) = (error, command);
    }
    Ok(found)
}

/// A signal behind a first-order filter with a time constant in samples, exact for a signal that is linear in between.
fn filtered(signal: &[f64], time: f64) -> Cow<'_, [f64]> {
    if time <= 0.0 {
        return Cow::Borrowed(signal);
    }
    let lag = Lag::new(time, 1.0);
    let mut state = signal.first().copied().unwrap_or(0.0);
    let mut before = state;
    let follow = |&value: &f64| {
        state = lag.over(state, value, 0.5 * (before + value));
        before = value;
        state
    };
    Cow::Owned(signal.iter().map(follow).collect())
}

/// Delayed samples by cubic interpolation.
#[derive(Debug, Clone, Copy)]
struct Taps {
    first: i64,
    weights: [f64; 4],
}

// Records are shorter than 2^62 samples.
#[allow(clippy::cast_possible_truncation, clippy::cast_possible_wrap, clippy::cast_sign_loss)]
impl Taps {
    fn new(delay: f64) -> Self {
        let whole = (-delay).floor();
        let x = -delay - whole;
        let weights = [
            0.5 * x * (-1.0 + x * (2.0 - x)),
            1.0 + 0.5 * x * x * (3.0 * x - 5.0),
            0.5 * x * (1.0 + x * (4.0 - 3.0 * x)),
            0.5 * x * x * (x - 1.0),
        ];
        Self { first: whole as i64 - 1, weights }
    }

    /// A signal is constant beyond its ends.
    #[inline(always)]
    fn of(&self, signal: &[f64], k: usize) -> f64 {
        let first = k as i64 + self.first;
        if first >= 0 && first as usize + 4 <= signal.len() {
            let near = &signal[first as usize..first as usize + 4];
            return near.iter().zip(self.weights).map(|(value, weight)| value * weight).sum();
        }
        let last = signal.len() as i64 - 1;
        let at = |place: i64| signal[place.clamp(0, last) as usize];
        self.weights.iter().zip(first..).map(|(weight, place)| weight * at(place)).sum()
    }
}

/// The mean of two delays.
#[derive(Debug, Clone, Copy)]
struct Pair {
    near: Taps,
    far: Option<Taps>,
}

impl Pair {
    fn new(delay: f64, apart: f64) -> Self {
        Self { near: Taps::new(delay - apart), far: (apart > 0.0).then(|| Taps::new(delay + apart)) }
    }

    #[inline(always)]
    fn of(&self, signal: &[f64], k: usize) -> f64 {
        let near = self.near.of(signal, k);
        self.far.map_or(near, |far| 0.5 * (near + far.of(signal, k)))
    }
}
