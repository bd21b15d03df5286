//! When limits take hold and let go.

use crate::scalar::{Scalar, smaller};

use super::flow::{Equations, Flow, State};
use super::terms::{Integral, Mode, Side};

/// A command so close to a ceiling is at it.
pub const AT_CEILING: f64 = 1e-9;

/// Number of conditions that may end a mode.
pub const CONDITIONS: usize = 8;

/// A condition that ends a mode where it is no longer met.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Condition {
    Rack(Side),
    Torque(Side),
    Rate(Side),
    Integral(Side),
}

/// All of them.
pub const ALL: [Condition; CONDITIONS] = [
    Condition::Rack(Side::High),
    Condition::Rack(Side::Low),
    Condition::Torque(Side::High),
    Condition::Torque(Side::Low),
    Condition::Rate(Side::High),
    Condition::Rate(Side::Low),
    Condition::Integral(Side::High),
    Condition::Integral(Side::Low),
];

#[inline(always)]
fn larger<T: Scalar>(number: T, other: T) -> T {
    if number.value() > other.value() { number } else { other }
}

impl<T: Scalar> Equations<T> {
    /// By how much a condition is met; below zero it is not, and infinity where it can't be missed.
    #[inline(always)]
    pub fn margin(&self, condition: Condition, flow: &Flow<T>, state: &State<T>, mode: Mode) -> T {
        let never = state.engine.constant(f64::INFINITY);
        let margin = match condition {
            Condition::Rack(side) => self.rack_margin(side, flow, mode),
            Condition::Torque(side) => self.torque_margin(side, flow, state, mode),
            Condition::Rate(side) => self.rate_margin(side, flow, state, mode),
            Condition::Integral(side) => self.integral_margin(side, flow, state, mode),
        };
        margin.unwrap_or(never)
    }

    /// Whether the sum keeps the command exactly on the ceiling that the rack's or the torque's limit makes: then these hold.
    #[inline(always)]
    fn pinned(&self, mode: Mode) -> bool {
        self.elements.direct() && !self.rack_is_state(mode) && matches!(mode.integral, Integral::Slides(_))
    }

    #[inline(always)]
    fn rack_margin(&self, side: Side, flow: &Flow<T>, mode: Mode) -> Option<T> {
        if !self.elements.rack_limit || self.elements.sampled || self.pinned(mode) {
            return None;
        }
        let limit = if side == Side::High { self.terms.x_max } else { self.terms.x_min };
        if limit.value().is_infinite() || (mode.rack != Side::Free && mode.rack != side) {
            return None;
        }
        let beyond = if side == Side::High { flow.asked - limit } else { limit - flow.asked };
        Some(if mode.rack == side { beyond } else { beyond * -1.0 })
    }

    #[inline(always)]
    fn torque_margin(&self, side: Side, flow: &Flow<T>, state: &State<T>, mode: Mode) -> Option<T> {
        if !self.elements.torque_limit || self.pinned(mode) {
            return None;
        }
        let limit = self.torque_limit(side, state.engine);
        if limit.value().is_infinite() || (mode.torque != Side::Free && mode.torque != side) {
            return None;
        }
        let beyond = if side == Side::High { flow.raw - limit } else { limit - flow.raw };
        Some(if mode.torque == side { beyond } else { beyond * -1.0 })
    }

    #[inline(always)]
    fn rate_margin(&self, side: Side, flow: &Flow<T>, state: &State<T>, mode: Mode) -> Option<T> {
        if !self.elements.rate_limit || (mode.rate != Side::Free && mode.rate != side) {
            return None;
        }
        let sign = if side == Side::High { 1.0 } else { -1.0 };
        let rate = if side == Side::High { self.terms.rate_up } else { self.terms.rate_down };
        if rate.value().is_infinite() {
            return None;
        }
        let target = self.target(flow, mode);
        if self.elements.lag {
            let beyond = (target - state.rack) / self.terms.tau_act * sign - rate;
            return Some(if mode.rate == side { beyond } else { beyond * -1.0 });
        }
        if mode.rate == side {
            return Some((target - state.rack) * sign);
        }
        if self.elements.sampled {
            return None;
        }
        let slope = if mode.rack == Side::Free { flow.asked_slope } else { rate.constant(0.0) };
        Some(rate - slope * sign)
    }

    /// What the actuator is to reach.
    #[inline(always)]
    pub fn target(&self, flow: &Flow<T>, mode: Mode) -> T {
        match mode.rack {
            Side::Free => flow.asked,
            Side::High => self.terms.x_max,
            Side::Low => self.terms.x_min,
        }
    }

    #[inline(always)]
    fn integral_margin(&self, side: Side, flow: &Flow<T>, state: &State<T>, mode: Mode) -> Option<T> {
        if !self.elements.anti_windup || self.elements.sampled {
            return None;
        }
        let sign = if side == Side::High { 1.0 } else { -1.0 };
        let ceiling = self.ceiling(side, state.engine);
        if ceiling.value().is_infinite() {
            return None;
        }
        let (beyond, miss) = ((flow.command - ceiling) * sign, flow.miss * sign);
        match mode.integral {
            Integral::Runs => Some(larger(beyond * -1.0, miss * -1.0)),
            Integral::Stands(held) if held == side => Some(smaller(beyond, miss)),
            Integral::Slides(held) if held == side => {
                let rate = flow.rates.sum * sign;
                Some(smaller(rate, miss - rate))
            }
            _ => None,
        }
    }
}

impl Equations<f64> {
    /// The mode behind a condition that is no longer met.
    pub fn next_mode(
        &self,
        condition: Condition,
        mode: Mode,
        flow_in: impl Fn(Mode) -> Flow<f64>,
        state: &State<f64>,
    ) -> Mode {
        let other = |held: Side, side: Side| if held == side { Side::Free } else { side };
        match condition {
            Condition::Rack(side) => Mode { rack: other(mode.rack, side), ..mode },
            Condition::Torque(side) => Mode { torque: other(mode.torque, side), ..mode },
            Condition::Rate(side) => Mode { rate: other(mode.rate, side), ..mode },
            Condition::Integral(side) => self.next_integral(side, mode, flow_in, state),
        }
    }

    fn next_integral(
        &self,
        side: Side,
        mode: Mode,
        flow_in: impl Fn(Mode) -> Flow<f64>,
        state: &State<f64>,
    ) -> Mode {
        let sign = if side == Side::High { 1.0 } else { -1.0 };
        let (mut past, mut short) = (mode, mode);
        (past.integral, short.integral) = (Integral::Stands(side), Integral::Runs);
        if self.elements.direct() && !self.rack_is_state(mode) {
            if self.torque_binds(side, state.engine) {
                (past.torque, short.torque) = (side, Side::Free);
            } else {
                (past.rack, short.rack) = (side, Side::Free);
            }
        }
        let sliding = Mode { integral: Integral::Slides(side), ..past };
        if matches!(mode.integral, Integral::Slides(_)) {
            let falls = flow_in(mode).rates.sum * sign < 0.0;
            return if falls { past } else { short };
        }
        let flow = flow_in(mode);
        let beyond = (flow.command - self.ceiling(side, state.engine)) * sign;
        if beyond.abs() > AT_CEILING {
            let holds = beyond > 0.0 && mode.integral == Integral::Runs;
            let integral = if holds { Integral::Stands(side) } else { Integral::Runs };
            return Mode { integral, ..mode };
        }
        let away = |mode: Mode| {
            let flow = flow_in(mode);
            (flow.command_slope - self.ceiling_slope(side, state.engine, flow.rates.engine)) * sign
        };
        let (falls_back, passes) = (away(past) < 0.0, away(short) > 0.0);
        match (falls_back, passes) {
            (true, true) => sliding,
            (false, _) => past,
            (true, false) => short,
        }
    }
}
