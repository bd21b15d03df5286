//! What stays the same over a run of the ship: its constants, and which of its elements act.

use crate::scalar::Scalar;

use super::parameters::{Parameters, at};
use super::run::Run;

/// Constants of a run.
pub struct Constants<T> {
    pub inverse_tau: T,
    /// Step over `tau_n`.
    pub step_over_tau: T,
    pub g: T,
    pub v: T,
    pub k_p: T,
    pub k_i: T,
    pub k_d: T,
    pub tau_prop: T,
    pub load_gain: T,
    pub s_m: T,
    pub lag: Lag<T>,
    pub highest: T,
    pub highest_slope: T,
    pub softness: T,
    pub lowest: T,
    pub fastest_up: T,
    pub fastest_down: T,
    pub rack_most: T,
    pub rack_least: T,
}

/// An actuator's lag over a step.
pub struct Lag<T> {
    /// Its time constant [s], and that over the step.
    pub time: T,
    pub in_steps: T,
    /// What is left of its state.
    pub stays: T,
    /// What it follows of the part by which the command's end is beyond its mean.
    pub bend: T,
    /// What it follows of a command that rises from zero to one over the step.
    pub follows: T,
}

impl<T: Scalar> Lag<T> {
    fn new(time: T, h: f64) -> Self {
        let value = time.value();
        let stays = if value > 0.0 {
            let stays = (-h / value).exp();
            time.function(stays, stays * h / (value * value))
        } else {
            time.constant(0.0)
        };
        let in_steps = time * (1.0 / h);
        let behind = in_steps * (stays * -1.0 + 1.0);
        Self { time, in_steps, stays, bend: (stays - behind) * 2.0, follows: behind * -1.0 + 1.0 }
    }
}

impl<T: Scalar> Constants<T> {
    /// From the parameters as numbers, for a step `h` [s].
    pub fn new(number: &impl Fn(usize) -> T, h: f64) -> Self {
        let tau = number(at::TAU_N);
        let inverse_tau = tau.constant(1.0) / tau;
        Self {
            inverse_tau,
            step_over_tau: inverse_tau * h,
            g: number(at::G),
            v: number(at::V),
            k_p: number(at::K_P),
            k_i: number(at::K_I),
            k_d: number(at::K_D),
            tau_prop: number(at::TAU_PROP),
            load_gain: number(at::LOAD_GAIN),
            s_m: number(at::S_M),
            lag: Lag::new(number(at::TAU_ACT), h),
            highest: number(at::M_MAX),
            highest_slope: number(at::M_MAX_SLOPE),
            softness: number(at::M_SOFT),
            lowest: number(at::M_MIN),
            fastest_up: number(at::RATE_UP) * h,
            fastest_down: number(at::RATE_DOWN) * -h,
            rack_most: number(at::X_MAX),
            rack_least: number(at::X_MIN),
        }
    }
}

/// Which elements act, so that the others cost nothing.
#[derive(Clone, Copy)]
#[allow(clippy::struct_excessive_bools)]
pub struct Acting {
    pub gain: bool,
    pub derivative: bool,
    pub curvature: bool,
    pub damping: bool,
    pub lag: bool,
    pub hold: bool,
    /// A command that jumps moves the rack at once.
    pub at_once: bool,
    pub torque_limit: bool,
    pub rate: bool,
    pub rack_limit: bool,
    pub anti_windup: bool,
    pub scale: bool,
    pub load: bool,
    pub channels: bool,
    /// Inputs jump from step to step.
    pub jumps: bool,
}

impl Acting {
    /// What acts by its value, or because a derivative by it is asked for.
    pub fn new(parameters: &Parameters, run: &Run<'_>, wrt: &[usize]) -> Self {
        let acts = |place: usize| !parameters.is_off(place) || wrt.contains(&place);
        let rate = acts(at::RATE_UP) || acts(at::RATE_DOWN);
        Self {
            gain: parameters.of(at::V) != 1.0 || wrt.contains(&at::V),
            derivative: acts(at::K_D) && run.detail.is_none(),
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
