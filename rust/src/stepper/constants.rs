//! Constants of a simulation: parameters, and which elements act.

use super::parameters::{Parameters, at};
use super::run::Run;

/// Constants of a simulation.
pub struct Constants {
    pub inverse_tau: f64,
    /// Step over `tau_n`.
    pub step_over_tau: f64,
    /// Slope of the torque over the speed: the part that acts at once, and the part behind the engine's lag.
    pub g: f64,
    pub late_g: f64,
    pub v: f64,
    pub k_p: f64,
    pub k_i: f64,
    pub k_d: f64,
    /// Decrease of the set point over the command. The gains `k_p`, `k_i` and `k_d` are divided by 1 + `droop` `K_p`.
    pub droop: f64,
    pub tau_prop: f64,
    pub load_gain: f64,
    pub s_m: f64,
    pub lag: Lag,
    /// Filter of the measured speed in the governor.
    pub filter: Lag,
    /// Lag of the engine's torque behind fuel and slope.
    pub charge: Lag,
    pub highest: f64,
    pub highest_slope: f64,
    pub softness: f64,
    pub lowest: f64,
    pub fastest_up: f64,
    pub fastest_down: f64,
    pub rack_most: f64,
    pub rack_least: f64,
}

/// Response of a first-order lag over a step.
pub struct Lag {
    /// Time constant [s], and its ratio to the step.
    pub time: f64,
    pub in_steps: f64,
    /// Factor of the state.
    pub stays: f64,
    /// Factor of the difference between the command at the step's end and the command's mean over the step.
    pub bend: f64,
    /// Response to a command that rises from zero to one over the step.
    pub follows: f64,
}

impl Lag {
    pub fn new(time: f64, h: f64) -> Self {
        let stays = if time > 0.0 { (-h / time).exp() } else { 0.0 };
        let in_steps = time * (1.0 / h);
        let behind = in_steps * (1.0 - stays);
        Self { time, in_steps, stays, bend: (stays - behind) * 2.0, follows: 1.0 - behind }
    }

    /// State at the end of a step, for a linear input with an end and a mean.
    #[inline(always)]
    pub fn over(&self, state: f64, end: f64, mean: f64) -> f64 {
        end + (state - end) * self.stays + (end - mean) * self.bend
    }
}

impl Constants {
    /// Constants for a step `h` [s].
    pub fn new(parameters: &Parameters, h: f64) -> Self {
        let inverse_tau = 1.0 / parameters.of(at::TAU_N);
        let (g, charge) = (parameters.of(at::G), Lag::new(parameters.of(at::TAU_ENG), h));
        let droop = parameters.of(at::DROOP) * parameters.of(at::V);
        let less = 1.0 / (1.0 + droop * parameters.of(at::K_P));
        let (g, late_g) = if charge.time > 0.0 { (0.0, g) } else { (g, 0.0) };
        Self {
            inverse_tau,
            step_over_tau: inverse_tau * h,
            g,
            late_g,
            v: parameters.of(at::V),
            k_p: parameters.of(at::K_P) * less,
            k_i: parameters.of(at::K_I) * less,
            k_d: parameters.of(at::K_D) * less,
            droop,
            tau_prop: parameters.of(at::TAU_PROP),
            load_gain: parameters.of(at::LOAD_GAIN),
            s_m: parameters.of(at::S_M),
            lag: Lag::new(parameters.of(at::TAU_ACT), h),
            filter: Lag::new(parameters.of(at::T_F), h),
            charge,
            highest: parameters.of(at::M_MAX),
            highest_slope: parameters.of(at::M_MAX_SLOPE),
            softness: parameters.of(at::M_SOFT),
            lowest: parameters.of(at::M_MIN),
            fastest_up: parameters.of(at::RATE_UP),
            fastest_down: -parameters.of(at::RATE_DOWN),
            rack_most: parameters.of(at::X_MAX),
            rack_least: parameters.of(at::X_MIN),
        }
    }
}

/// Elements that act; the stepper does not compute the others.
#[derive(Clone, Copy)]
#[allow(clippy::struct_excessive_bools)]
pub struct Acting {
    pub gain: bool,
    /// The derivative acts on the speed itself.
    pub derivative: bool,
    pub filter: bool,
    pub charge: bool,
    pub curvature: bool,
    pub damping: bool,
    pub lag: bool,
    pub hold: bool,
    /// A jump of the command moves the rack immediately.
    pub at_once: bool,
    pub torque_limit: bool,
    pub rate: bool,
    pub rack_limit: bool,
    pub anti_windup: bool,
    pub scale: bool,
    pub load: bool,
    pub channels: bool,
    /// Inputs jump between steps.
    pub jumps: bool,
}

impl Acting {
    pub fn new(parameters: &Parameters, run: &Run<'_>) -> Self {
        let acts = |place: usize| !parameters.is_off(place);
        let rate = acts(at::RATE_UP) || acts(at::RATE_DOWN);
        Self {
            gain: parameters.of(at::V) != 1.0,
            derivative: acts(at::K_D) && run.detail.is_none() && !acts(at::T_F),
            filter: acts(at::T_F),
            charge: acts(at::TAU_ENG),
            curvature: acts(at::CURVATURE),
            damping: acts(at::DAMPING),
            lag: acts(at::TAU_ACT),
            hold: acts(at::HOLD) && parameters.is_off(at::T_S),
            at_once: parameters.of(at::TAU_ACT) == 0.0 && !rate,
            torque_limit: acts(at::M_MAX) || acts(at::M_MIN) || run.envelope.is_some(),
            rate,
            rack_limit: acts(at::X_MAX) || acts(at::X_MIN) || run.detail.is_some_and(super::Detail::smokes),
            anti_windup: parameters.of(at::ANTI_WINDUP) == 1.0,
            scale: acts(at::S_U) || acts(at::U_0),
            load: acts(at::LOAD_GAIN) && !run.load.is_empty(),
            channels: acts(at::T_N) || acts(at::T_M),
            jumps: run.hold == crate::hold::Hold::Zero,
        }
    }
}
