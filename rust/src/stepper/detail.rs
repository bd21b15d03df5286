//! Additional elements of a whole drive train's simulation: single firings, smoke limiter, torque rate, drag, propeller
//! ripple and ship motion.
//!
//! Torques are relative to the engine's torque at the operating point, times gear ratio and efficiency; `bollard` is the
//! propeller's bollard-pull torque at the operating point's speed. `Q` and `T` are torque and thrust of the propeller
//! over bollard pull at the flow angle, `w` the water speed over the blade speed at the operating point, `C` the rack for
//! which the charge air suffices, and `F` the filtered speed:
//!
//! ```text
//! L = bollard Q(w, N) hypot(w, N)^p (1 + shaft_ripple cos(turn) + blade_ripple cos(blades turn))
//! dw/dt = push T(w, N) hypot(w, N)^2 - resistance w |w|        tau_n dN/dt = M_b - drag N^drag_exponent - L
//! tau_air dC/dt = A - C, A <= C + margin        T_f dF/dt = N - F, which K_d (N - F) / T_f follows
//! ```
//!
//! A sampling governor filters by `(T_f + T_s) dF = T_s (N - F)`; with `once_a_firing` it samples when a cylinder fires.

use crate::error::{Error, Result, require};
use crate::power::power;
use crate::subnormal::cut;

use super::firing::Firing;
use super::propeller::{Propeller, Quadrants};

/// Number of parameters.
const COUNT: usize = 18;

/// Names of the parameters of a [`Detail`], in order.
pub const DETAIL: [&str; COUNT] = [
    "T_f",
    "margin",
    "tau_air",
    "torque_rate",
    "interval",
    "width",
    "engine_hz",
    "once_a_firing",
    "drag",
    "drag_exponent",
    "bollard",
    "shaft_hz",
    "blades",
    "shaft_ripple",
    "blade_ripple",
    "water",
    "push",
    "resistance",
];

/// Additional elements of a simulation (see the module): values of the parameters named in [`DETAIL`], and states.
#[derive(Debug, Clone)]
pub struct Detail {
    /// Time constants of the derivative's filter and of the charge air [s].
    filter: f64,
    tau_air: f64,
    margin: f64,
    torque_rate: f64,
    drag: f64,
    drag_exponent: f64,
    pub(super) once_a_firing: bool,
    pub(super) firing: Option<Firing>,
    pub(super) propeller: Propeller,
    filtered: f64,
    /// Rate of the filtered speed, on which the governor's derivative acts.
    pub(super) pace: f64,
    air: f64,
    /// Highest rack without the charge air's limit.
    pub(super) stop: f64,
    /// Mean engine torque after its rate limit, and delivered torque.
    mean: f64,
    pub(super) brake: f64,
    /// Changes over the last step.
    drive_growth: f64,
    pub(super) load_growth: f64,
}

impl Detail {
    /// From a vector in the order of [`DETAIL`], each cylinder's torque over the mean, and tables of the propeller.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a wrong length or an invalid number.
    pub fn new(vector: &[f64], strength: &[f64], quadrants: Option<Quadrants>) -> Result<Self> {
        let numbers: [f64; COUNT] = vector.try_into().map_err(|_| {
            let found = vector.len();
            Error::Invalid(format!("detail: found {found} values, expected {COUNT}, see SHIP_DETAIL"))
        })?;
        for (name, value) in DETAIL.into_iter().zip(numbers) {
            let fits = value >= 0.0 && (value.is_finite() || ["margin", "torque_rate"].contains(&name));
            require(fits || name == "water" && value.is_finite(), || {
                format!("detail: found {name} = {value}, expected zero or more")
            })?;
        }
        let [
            filter,
            margin,
            tau_air,
            torque_rate,
            interval,
            width,
            engine_hz,
            once,
            drag,
            drag_exponent,
            load @ ..,
        ] = numbers;
        require(margin == f64::INFINITY || tau_air > 0.0, || {
            "detail: found tau_air = 0, expected a positive number beside a margin".to_owned()
        })?;
        require(once == 0.0 || interval > 0.0, || {
            "detail: found interval = 0, expected a positive angle beside once_a_firing".to_owned()
        })?;
        let firing = Firing::new([interval, width, engine_hz], strength)?;
        Ok(Self {
            filter,
            tau_air,
            margin,
            torque_rate,
            drag,
            drag_exponent,
            once_a_firing: once > 0.0,
            brake: firing.as_ref().map_or(1.0, |firing| firing.torques()[0]),
            firing,
            propeller: Propeller::new(load, quadrants),
            filtered: 1.0,
            pace: 0.0,
            air: 0.0,
            stop: f64::INFINITY,
            mean: 1.0,
            drive_growth: 0.0,
            load_growth: 0.0,
        })
    }

    /// Set decayed values to zero.
    pub(super) fn cut(&mut self) {
        let growths = [&mut self.drive_growth, &mut self.load_growth];
        for number in [&mut self.pace, &mut self.air, &mut self.propeller.pace].into_iter().chain(growths) {
            *number = cut(*number);
        }
    }

    /// Whether the charge air limits the rack.
    pub(super) const fn smokes(&self) -> bool {
        self.margin.is_finite()
    }

    /// Whether the governor's derivative, if any, acts on a filtered speed.
    pub(super) fn filters(&self) -> bool {
        self.filter > 0.0
    }

    /// Fraction of the step after which a cylinder fires.
    #[inline(always)]
    pub(super) fn fires(&self) -> Option<f64> {
        self.firing.as_ref().and_then(|firing| firing.due)
    }

    /// Predict a step `h` [s] at a mean speed: the next firing, and the mean torque of previous firings minus the drag.
    #[inline(always)]
    pub(super) fn foresee(&mut self, speed: f64, h: f64) -> Option<f64> {
        let lost = self.lost(speed);
        self.firing.as_mut().map(|firing| {
            firing.turn(speed, h);
            firing.torques()[1] - lost
        })
    }

    /// Update the derivative's filter for a speed that rises over a step `h` [s].
    #[inline(always)]
    pub(super) fn follow(&mut self, rise: f64, h: f64) {
        if self.filter > 0.0 {
            let stays = (-h / self.filter).exp();
            self.pace = self.pace * stays + rise / h * (1.0 - stays);
        }
    }

    /// Update the filter of a governor that samples a speed each `period` [s].
    #[inline(always)]
    pub(super) fn sample(&mut self, speed: f64, period: f64) {
        self.pace = (speed - self.filtered) / (self.filter + period);
        self.filtered += period * self.pace;
    }

    /// Highest rack at the end of a step, from the rack at its beginning.
    #[inline(always)]
    pub(super) fn ceiling(&self, rack: f64, h: f64) -> f64 {
        (self.air + h / self.tau_air * (rack - self.air) + self.margin).min(self.stop)
    }

    /// Update the charge air by the mean rack of a step.
    #[inline(always)]
    pub(super) fn breathe(&mut self, rack: f64, h: f64) {
        if self.smokes() {
            self.air += (1.0 - (-h / self.tau_air).exp()) * (rack - self.air);
        }
    }

    /// Torque on the engine's side minus drag, for a commanded mean torque.
    #[inline(always)]
    pub(super) fn net(&mut self, asked: f64, speed: f64) -> f64 {
        if self.firing.is_none() && self.torque_rate == f64::INFINITY {
            self.brake = asked;
        }
        self.brake - self.lost(speed)
    }

    #[inline(always)]
    fn lost(&self, speed: f64) -> f64 {
        if self.drag == 0.0 { 0.0 } else { self.drag * power(speed, self.drag_exponent) }
    }

    /// Torque on the engine's side minus drag at both ends of a step, from the commanded torques. The ends are corrected
    /// so that a straight line between them has the mean of the true curve. With `stairs` the command jumps within the
    /// step.
    #[inline(always)]
    pub(super) fn drive(
        &mut self,
        [mut from, mut to]: [f64; 2],
        speeds: [f64; 2],
        h: f64,
        stairs: bool,
    ) -> [f64; 2] {
        if self.torque_rate < f64::INFINITY {
            let reach = self.torque_rate * h;
            from = self.mean;
            to = to.max(from - reach).min(from + reach);
        }
        self.mean = to;
        let losses = speeds.map(|speed| self.lost(speed));
        let Some(firing) = &mut self.firing else {
            self.brake = to;
            return bent([from - losses[0], to - losses[1]], &mut self.drive_growth);
        };
        let (growth, before) = (to - from, std::mem::replace(&mut self.drive_growth, to - from));
        if let Some(part) = firing.due {
            let bend = if stairs { 0.0 } else { growth - before };
            firing.fire(from + part * growth + 0.5 * part * (part - 1.0) * bend);
        }
        let [torque, mean] = firing.torques();
        let less = 0.5 * (self.brake + torque) - mean;
        let begun = std::mem::replace(&mut self.brake, torque);
        [begun - less - losses[0], torque - less - losses[1]]
    }

    /// Load at both ends of a step, corrected so that a straight line between both has the mean of the true curve.
    #[inline(always)]
    pub(super) fn bent_load(&mut self, ends: [f64; 2]) -> [f64; 2] {
        bent(ends, &mut self.load_growth)
    }
}

/// Ends of a straight line with the mean of a parabola through the step's ends; the parabola follows from the change over
/// the previous step.
#[inline(always)]
fn bent([from, to]: [f64; 2], growth: &mut f64) -> [f64; 2] {
    let less = (to - from - *growth) / 12.0;
    *growth = to - from;
    [from - less, to - less]
}
