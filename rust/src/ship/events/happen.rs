//! What happens at the ends of steps: samples of the governor, arrivals, breaks of the inputs, and switches.

use pulp::Simd;

use crate::scalar::{Dual, Scalar};

use super::command::{Arrival, Segment};
use super::flow::{Flow, State};
use super::held::Piece;
use super::inputs::{Inputs, step};
use super::locate::{self, SLACK, Switch};
use super::march::{Course, March, Next, Step};
use super::switches::{ALL, Condition};
use super::terms::{Integral, Mode, Side};

/// Breaks of a command up to this order end steps.
const LAST_BREAK: u8 = 2;
/// The same where a millionth of a step does not count.
const LAST_ROUGH_BREAK: u8 = 1;
/// Passes through a step that is longer than the dead time, each of which knows the command within better.
const PASSES: usize = 5;
/// Most switches at one time.
const MOST_AT_ONCE: usize = 12;
/// A command that has left a ceiling by more than this has jumped.
const JUMPED: f64 = 1e-7;
/// Rack positions closer than this are one.
const SAME_RACK: f64 = 1e-11;

/// Inputs over a stretch and the times between which its past is looked up.
pub type Stretch = (Piece, Piece, [f64; 2]);

impl<S: Simd, const N: usize> March<'_, S, N> {
    /// What comes at a known time, once the state is there.
    #[inline(always)]
    pub(super) fn happen(&mut self, next: Next, time: Dual<S, N>) {
        let elements = self.equations.elements;
        let before = self.flow_now();
        match next {
            Next::Sample => return self.order(time, self.state.engine, Some(before.rates.engine)),
            Next::Arrival => self.arrive(),
            Next::Set => {
                self.set_sample += 1;
                self.push_break(u8::from(!self.set.jumps()));
            }
            Next::Load => {
                self.load_sample += 1;
                self.push_break(1 + u8::from(!self.load.jumps()) - u8::from(elements.derivative));
            }
            Next::Reading(_) => return,
        }
        self.settle(before.rack);
        let late = self.equations.terms.t_d;
        if elements.direct() && next == Next::Set && self.set.jumps() && !late.is_zero() {
            // A dead time that is off, or so short that the first order will do: the jump comes later.
            let after = self.flow_now();
            let (before, after) = (&before.rates, &after.rates);
            let state = &mut self.state;
            state.engine = state.engine + (before.engine - after.engine) * late;
            state.propeller = state.propeller + (before.propeller - after.propeller) * late;
            state.spring = state.spring + (before.spring - after.spring) * late;
            state.rack = state.rack + (before.rack - after.rack) * late;
        }
    }

    /// A break of a delayed command comes out of its dead time later.
    #[inline(always)]
    fn push_break(&mut self, order: u8) {
        let last = if self.run.sharp { LAST_BREAK } else { LAST_ROUGH_BREAK };
        if self.equations.elements.delayed && order <= last {
            self.arrivals.push(self.now + self.equations.terms.t_d, Arrival::Break(order));
        }
    }

    /// Whether a command that a switch has broken arrives before a time.
    #[inline(always)]
    pub(super) fn breaks_before(&self, time: f64) -> bool {
        self.arrivals.next().is_some_and(|broken| broken.value() < time - self.same(time))
    }

    /// What is next on its way reaches the actuator.
    #[inline(always)]
    pub(super) fn arrive(&mut self) {
        match self.arrivals.pop() {
            Some((_, Arrival::Command(command))) => self.held = command,
            Some((_, Arrival::Break(order))) => {
                self.broken = self.now.value();
                self.push_break(order + 1);
            }
            None => {}
        }
    }

    /// The governor reads speed and set point, and orders; the rate of the speed is for its derivative gain.
    #[inline(always)]
    pub(super) fn order(&mut self, time: Dual<S, N>, speed: Dual<S, N>, rate: Option<Dual<S, N>>) {
        self.sample += 1.0;
        let (equations, elements) = (&self.equations, self.equations.elements);
        let t = &equations.terms;
        let piece = self.set.piece(time.value() - t.t_set.value());
        let miss = t.s_u * piece.at(time - t.t_set) - speed;
        let added = self.state.sum + t.t_s * miss;
        let order = |sum: Dual<S, N>| {
            let command = t.k_p * miss + t.k_i * sum + equations.bias;
            match rate {
                Some(rate) if elements.derivative => command - t.k_d * rate,
                _ => command,
            }
        };
        let command = order(if elements.before_use { added } else { self.state.sum });
        let held = elements.anti_windup && {
            let ceiling = |side| equations.ceiling(side, speed).value();
            (command.value() > ceiling(Side::High) && miss.value() > 0.0)
                || (command.value() < ceiling(Side::Low) && miss.value() < 0.0)
        };
        let command = if held { order(self.state.sum) } else { command };
        let arrival = time + t.t_d;
        if !held {
            self.state.sum = added;
        }
        self.arrivals.push(arrival, Arrival::Command(command));
    }

    /// Find the mode anew after a break; `rack` is where the rack was before.
    #[inline(always)]
    pub(super) fn settle(&mut self, rack: Dual<S, N>) {
        let elements = self.equations.elements;
        self.leave_ceiling();
        if elements.rate_limit && !elements.lag {
            if self.mode.rate == Side::Free {
                self.state.rack = rack;
            }
            let rack = self.state.rack;
            self.mode.rate = Side::High;
            self.resettle(false);
            let stretch = self.here();
            let target = self.plain.target(&self.plain_flow(stretch, self.mode), self.mode);
            let rise = target - rack.value();
            self.mode.rate = match rise {
                _ if rise > SAME_RACK => Side::High,
                _ if rise < -SAME_RACK => Side::Low,
                _ => Side::Free,
            };
        }
        self.resettle(true);
        if matches!(self.mode.integral, Integral::Slides(_)) {
            let stretch = self.here();
            self.project(stretch);
        }
    }

    /// Switch until every condition is met.
    fn resettle(&mut self, rates: bool) {
        if !self.equations.elements.watched() && !self.equations.elements.rack_limit {
            return;
        }
        let stretch = self.here();
        let state = self.state.map(Dual::value);
        self.settle_rack_limit();
        for _ in 0..MOST_AT_ONCE {
            let flow = self.plain_flow(stretch, self.mode);
            let missed = ALL.into_iter().find(|&condition| {
                (rates || !matches!(condition, Condition::Rate(_)))
                    && self.plain.margin(condition, &flow, &state, self.mode) < -SLACK
            });
            let Some(condition) = missed else { break };
            self.mode =
                self.plain.next_mode(condition, self.mode, |mode| self.plain_flow(stretch, mode), &state);
        }
    }

    /// A sampled command is limited as it arrives.
    fn settle_rack_limit(&mut self) {
        let (t, elements) = (&self.plain.terms, &self.plain.elements);
        if elements.sampled && elements.rack_limit {
            let held = self.held.value();
            self.mode.rack = match held {
                _ if held > t.x_max => Side::High,
                _ if held < t.x_min => Side::Low,
                _ => Side::Free,
            };
        }
    }

    /// A jump may have taken a sliding command off its ceiling.
    fn leave_ceiling(&mut self) {
        let Integral::Slides(side) = self.mode.integral else { return };
        let stretch = self.here();
        let flow = self.plain_flow(stretch, self.mode);
        if (flow.command - self.plain.ceiling(side, self.state.engine.value())).abs() > JUMPED {
            self.mode.integral = Integral::Runs;
            if self.equations.elements.direct() {
                (self.mode.torque, self.mode.rack) = (Side::Free, Side::Free);
            }
        }
    }

    /// Put a sliding command onto its ceiling to the last digit, and its derivatives with it.
    #[inline(always)]
    fn project(&mut self, stretch: Stretch) {
        let Integral::Slides(side) = self.mode.integral else { return };
        let flow = self.flow_in(stretch);
        let ceiling = self.equations.ceiling(side, self.state.engine);
        if ceiling.value().is_finite() {
            self.state.sum = self.state.sum + (ceiling - flow.command) / self.equations.terms.k_i;
        }
    }

    /// All signals now, without derivatives.
    fn plain_flow(&self, (set, load, within): Stretch, mode: Mode) -> Flow<f64> {
        let inputs = Inputs { set, load, held: self.held, past: &self.past, within };
        let at = inputs.value_at(&self.plain, self.now.value());
        self.plain.flow(&at, &self.state.map(Dual::value), mode)
    }

    /// The first switch within so long [s] from now.
    pub(super) fn first_switch(&self, (set, load, within): Stretch, length: f64) -> Option<Switch> {
        let inputs = Inputs { set, load, held: self.held, past: &self.past, within };
        let (plain, mode, start) = (&self.plain, self.mode, self.now.value());
        let input = |time: f64| inputs.value_at(plain, time);
        let state = self.state.map(Dual::value);
        let at = |elapsed: f64| {
            if elapsed > 0.0 { step(plain, input, start, elapsed, &state, mode) } else { state }
        };
        locate::first(&Course { equations: plain, input: &input, start, mode, at }, length)
    }

    /// The time to a switch as a number with its derivatives: the margin stays zero there.
    #[inline(always)]
    pub(super) fn located(&self, stretch: Stretch, left: Dual<S, N>, switch: &Switch) -> Dual<S, N> {
        let length = left.constant(switch.elapsed);
        if switch.slope * left.value() >= -SLACK {
            return length;
        }
        let state = self.after(stretch, length);
        let (set, load, within) = stretch;
        let inputs = Inputs { set, load, held: self.held, past: &self.past, within };
        let flow = self.flow_of(&inputs, self.now + length, &state);
        let margin = self.equations.margin(switch.condition, &flow, &state, self.mode);
        margin.function(switch.elapsed, -1.0 / switch.slope)
    }

    /// The state so long [s] from now.
    #[inline(always)]
    fn after(&self, (set, load, within): Stretch, length: Dual<S, N>) -> State<Dual<S, N>> {
        let inputs = Inputs { set, load, held: self.held, past: &self.past, within };
        let (equations, start, state, mode) = (&self.equations, self.now, &self.state, self.mode);
        self.now.apart(Step { equations, inputs: &inputs, start, length, state, mode })
    }

    /// Switch, the state being where a condition is no longer met.
    #[inline(always)]
    pub(super) fn switch(&mut self, stretch: Stretch, switch: &Switch) {
        let elements = self.equations.elements;
        let leaves = matches!(switch.condition, Condition::Rate(_)) && self.mode.rate == Side::Free;
        if leaves && !elements.lag {
            self.state.rack = self.flow_in(stretch).rack;
        }
        let state = self.state.map(Dual::value);
        let flow_in = |mode| self.plain_flow(stretch, mode);
        self.mode = self.plain.next_mode(switch.condition, self.mode, flow_in, &state);
        self.project(stretch);
        self.push_break(1);
    }

    /// On by so long [s], at the end of which the past knows the command.
    #[inline(always)]
    pub(super) fn step(&mut self, stretch: Stretch, length: Dual<S, N>) {
        if !self.equations.elements.delayed {
            self.state = self.after(stretch, length);
            self.now = self.now + length;
            return;
        }
        if length.value() <= 0.0 {
            let flow = self.flow_in(stretch);
            self.state = self.state.after(length, &flow.rates);
            self.now = self.now + length;
            return;
        }
        let foreseen = self.foresee(stretch, length);
        let begin = self.flow_in(stretch);
        let state = self.after(stretch, length);
        let segment = self.segment(stretch, length, &begin, &state);
        if foreseen {
            self.past.pop();
        }
        self.past.push(segment);
        self.state = state;
        self.now = self.now + length;
    }

    /// The command over a step that ends in a state.
    #[inline(always)]
    fn segment(
        &self,
        (set, load, within): Stretch,
        length: Dual<S, N>,
        begin: &Flow<Dual<S, N>>,
        state: &State<Dual<S, N>>,
    ) -> Segment<Dual<S, N>> {
        let inputs = Inputs { set, load, held: self.held, past: &self.past, within };
        let end = self.flow_of(&inputs, self.now + length, state);
        Segment {
            start: self.now,
            length,
            from: begin.command,
            from_slope: begin.command_slope,
            to: end.command,
            to_slope: end.command_slope,
        }
    }

    /// In a step longer than the dead time the command within acts on itself: find it by passes through the step, and leave it
    /// as the end of the past. Whether that is so.
    #[inline(always)]
    pub(super) fn foresee(&mut self, stretch: Stretch, length: Dual<S, N>) -> bool {
        if !self.equations.elements.delayed || self.plain.terms.t_d >= length.value() {
            return false;
        }
        let begin = self.flow_in(stretch);
        let (from, from_slope) = (begin.command, begin.command_slope);
        let to = from + from_slope * length;
        self.past.push(Segment { start: self.now, length, from, from_slope, to, to_slope: from_slope });
        for _ in 0..PASSES {
            let state = self.after(stretch, length);
            let segment = self.segment(stretch, length, &begin, &state);
            self.past.pop();
            self.past.push(segment);
        }
        true
    }
}
