//! The ship's way through a record, from one time at which something happens to the next.
//!
//! Times are numbers that carry derivatives, too: steps end where a parameter or the state says, and what the state loses at
//! the rates before such a time and gains at those behind it is the jump of its derivatives (the saltation). A reading of
//! the record is at a time that stands still; the state moves there at the rates from behind. Such moves may have no length.

use pulp::{Simd, WithSimd};

use crate::error::Result;
use crate::scalar::{Dual, Scalar};
use crate::ship::march::{Consume, Task};
use crate::ship::output::Output;
use crate::ship::run::Run;
use crate::stop::Stop;

use super::command::{Arrival, Arrivals, Past};
use super::flow::{Equations, Flow, Input, State};
use super::happen::Stretch;
use super::held::Held;
use super::inputs::{Inputs, step};
use super::pace::longest_step;
use super::readings::Readings;
use super::switches::{ALL, CONDITIONS, Condition};
use super::terms::{Mode, Side};

/// Times closer than this share of a sample time are one.
const SAME: f64 = 1e-9;
/// Most switches in a step; more than that chatter, and the step ends with what holds by then.
const MOST_SWITCHES: usize = 40;
/// Steps between looks at the stop flag.
const LOOK_EVERY: usize = 256;

/// What happens next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Next {
    Sample,
    Arrival,
    Set,
    Load,
    Reading(usize),
}

/// A simulation under way.
pub struct March<'a, S, const N: usize> {
    pub(super) equations: Equations<Dual<S, N>>,
    pub(super) plain: Equations<f64>,
    pub(super) outputs: &'a [Output],
    pub(super) run: &'a Run<'a>,
    pub(super) stop: &'a Stop,
    pub(super) set: Held<'a>,
    pub(super) load: Held<'a>,
    pub(super) longest: f64,
    pub(super) now: Dual<S, N>,
    pub(super) state: State<Dual<S, N>>,
    pub(super) mode: Mode,
    /// Command that the actuator has.
    pub(super) held: Dual<S, N>,
    pub(super) past: Past<Dual<S, N>>,
    pub(super) arrivals: Arrivals<Dual<S, N>>,
    /// Numbers of the next samples of the governor, counted from `T_0`, of the set point and of the load.
    pub(super) sample: f64,
    pub(super) set_sample: usize,
    pub(super) load_sample: usize,
    steps: usize,
    /// When a break of the command last reached the actuator [s].
    pub(super) broken: f64,
    /// Switches since something happened at a known time.
    switches: usize,
    /// When they were last counted from [s].
    moved: f64,
}

/// The course of the state through a step, without derivatives.
pub struct Course<'a, F> {
    pub(super) equations: &'a Equations<f64>,
    pub(super) input: &'a dyn Fn(f64) -> Input<f64>,
    pub(super) start: f64,
    pub(super) mode: Mode,
    pub(super) at: F,
}

impl<F: Fn(f64) -> State<f64>> Course<'_, F> {
    /// All margins so long [s] after the step began.
    pub fn margins(&self, elapsed: f64) -> [f64; CONDITIONS] {
        let state = (self.at)(elapsed);
        let flow = self.equations.flow(&(self.input)(self.start + elapsed), &state, self.mode);
        ALL.map(|condition| self.equations.margin(condition, &flow, &state, self.mode))
    }

    /// One of them.
    pub fn margin(&self, elapsed: f64, condition: Condition) -> f64 {
        let state = (self.at)(elapsed);
        let flow = self.equations.flow(&(self.input)(self.start + elapsed), &state, self.mode);
        self.equations.margin(condition, &flow, &state, self.mode)
    }
}

/// A step in vectors, compiled once.
pub(super) struct Step<'a, S, const N: usize> {
    pub(super) equations: &'a Equations<Dual<S, N>>,
    pub(super) inputs: &'a Inputs<'a, Dual<S, N>>,
    pub(super) start: Dual<S, N>,
    pub(super) length: Dual<S, N>,
    pub(super) state: &'a State<Dual<S, N>>,
    pub(super) mode: Mode,
}

impl<S: Simd, const N: usize> WithSimd for Step<'_, S, N> {
    type Output = State<Dual<S, N>>;

    #[inline(always)]
    fn with_simd<V: Simd>(self, _simd: V) -> Self::Output {
        let input = |time| self.inputs.at(self.equations, time);
        step(self.equations, input, self.start, self.length, self.state, self.mode)
    }
}

/// The signals at an instant in vectors, compiled once.
struct FlowAt<'a, S, const N: usize> {
    equations: &'a Equations<Dual<S, N>>,
    inputs: &'a Inputs<'a, Dual<S, N>>,
    time: Dual<S, N>,
    state: &'a State<Dual<S, N>>,
    mode: Mode,
}

impl<S: Simd, const N: usize> WithSimd for FlowAt<'_, S, N> {
    type Output = Flow<Dual<S, N>>;

    #[inline(always)]
    fn with_simd<V: Simd>(self, _simd: V) -> Self::Output {
        self.equations.flow(&self.inputs.at(self.equations, self.time), self.state, self.mode)
    }
}

impl<'a, S: Simd, const N: usize> March<'a, S, N> {
    /// Before the first sample.
    ///
    /// # Errors
    /// [`Error::Invalid`] where the fastest time constant asks for more steps than anyone waits for.
    #[inline(always)]
    pub fn new(
        task: &'a Task<'a>,
        run: &'a Run<'a>,
        equations: Equations<Dual<S, N>>,
        plain: &Equations<f64>,
        stop: &'a Stop,
    ) -> Result<Self> {
        let set = Held::new(run.set, run.dt, run.hold);
        let load = Held::new(run.load, run.dt, run.hold);
        let zero = equations.terms.g.constant(0.0);
        let state = equations.start(set.first(), load.first());
        let longest = longest_step(plain, run)?;
        let period = plain.terms.t_s;
        let sample = if period > 0.0 { 0.0 } else { f64::INFINITY };
        let mut arrivals = Arrivals::new();
        if equations.elements.delayed {
            arrivals.push(equations.terms.t_d, Arrival::Break(0));
        }
        Ok(Self {
            outputs: task.outputs,
            run,
            stop,
            set,
            load,
            longest,
            now: zero,
            held: state.rack,
            past: Past::new(state.rack),
            state,
            mode: Mode::FREE,
            arrivals,
            sample,
            set_sample: if equations.elements.sampled { run.samples() } else { 0 },
            load_sample: if equations.elements.loaded { 0 } else { run.samples() },
            steps: 0,
            broken: f64::NEG_INFINITY,
            switches: 0,
            moved: 0.0,
            equations,
            plain: *plain,
        })
    }

    /// From the first sample to the last.
    ///
    /// # Errors
    /// What `consume` finds, or a request to stop.
    #[inline(always)]
    pub fn through(mut self, simd: S, directions: usize, consume: &mut Consume<'_>) -> Result<()> {
        let before = self.outputs.iter().map(|&output| self.before(output).tangent()).collect();
        let t = &self.equations.terms;
        let delays = [t.g.constant(0.0), t.t_n, t.t_m];
        let sizes = [self.run.samples(), directions];
        let mut readings = Readings::<Dual<S, N>, N>::new(self.outputs, delays, before, sizes, self.run.dt);
        self.settle(self.state.rack);
        if self.is_simple() {
            self.through_series(simd, &mut readings, consume)?;
        }
        while let Some((channel, reading)) = readings.next() {
            let (next, time) = self.next(channel, reading);
            if !self.move_to(time)? {
                continue;
            }
            // Only time that passes pardons: a dead time of next to nothing must not go round for ever.
            let moved = self.now.value();
            if moved > self.moved + self.same(moved) {
                (self.moved, self.switches) = (moved, 0);
            }
            if let Next::Reading(channel) = next {
                let flow = self.flow_now();
                for place in 0..readings.channels[channel].outputs.len() {
                    let output = readings.channels[channel].outputs[place];
                    readings.push(output, self.output(self.outputs[output], &flow).tangent());
                }
                readings.advance(channel);
                readings.give(consume)?;
                self.state = self.state.map(Dual::without_dust);
            } else {
                self.happen(next, time);
            }
        }
        readings.give(consume)
    }

    /// What an output was before the record.
    #[inline(always)]
    fn before(&self, output: Output) -> Dual<S, N> {
        let (t, state) = (&self.equations.terms, &self.state);
        let torque = t.g * (state.engine + -1.0) + t.initial_fuel + 1.0;
        match output {
            Output::Speed | Output::PropellerSpeed => state.engine + -1.0,
            Output::Sum => state.sum,
            Output::Rack => state.rack,
            Output::GaugeTorque => t.s_m * state.spring + -1.0,
            Output::EngineTorque => {
                let limit = |side| self.equations.torque_limit(side, state.engine);
                let torque =
                    if torque.value() > limit(Side::High).value() { limit(Side::High) } else { torque };
                let torque =
                    if torque.value() < limit(Side::Low).value() { limit(Side::Low) } else { torque };
                t.s_m * torque + -1.0
            }
        }
    }

    #[inline(always)]
    fn output(&self, output: Output, flow: &Flow<Dual<S, N>>) -> Dual<S, N> {
        let t = &self.equations.terms;
        match output {
            Output::PropellerSpeed if self.equations.elements.flexible => self.state.propeller + -1.0,
            Output::Speed | Output::PropellerSpeed => self.state.engine + -1.0,
            Output::EngineTorque => t.s_m * flow.brake + -1.0,
            Output::GaugeTorque => t.s_m * flow.gauge + -1.0,
            Output::Rack => flow.rack,
            Output::Sum => self.state.sum,
        }
    }

    /// What happens next, and when; a reading where nothing else comes before.
    #[inline(always)]
    fn next(&self, channel: usize, reading: Dual<S, N>) -> (Next, Dual<S, N>) {
        let (t, dt) = (&self.equations.terms, self.run.dt);
        let same = self.same(self.now.value());
        // At one time the governor samples before anything changes, and the record shows what is then.
        let (mut found, mut first) = (Next::Reading(channel), reading + 2.0 * same);
        let mut offer = |next: Next, time: Dual<S, N>| {
            if time.value() < first.value() - same {
                (found, first) = (next, time);
            }
        };
        if self.sample < f64::INFINITY {
            offer(Next::Sample, t.t_0 + t.t_s * self.sample);
        }
        if let Some(time) = self.arrivals.next() {
            offer(Next::Arrival, time);
        }
        if self.set_sample < self.run.samples() {
            offer(Next::Set, t.t_set + self.set_sample as f64 * dt);
        }
        if self.load_sample < self.run.samples() {
            offer(Next::Load, t.t_set.constant(self.load_sample as f64 * dt));
        }
        if let Next::Reading(_) = found { (found, reading) } else { (found, first) }
    }

    #[inline(always)]
    pub(super) fn same(&self, time: f64) -> f64 {
        (SAME * self.run.dt).max(8.0 * f64::EPSILON * time.abs())
    }

    /// The inputs over a stretch of so long [s] from now on.
    #[inline(always)]
    pub(super) fn stretch(&self, length: f64) -> Stretch {
        let (t, now) = (&self.plain.terms, self.now.value());
        // By what has happened, not by the time: several things may happen at one time.
        let (set, load) = (self.set.piece_after(self.set_sample), self.load.piece_after(self.load_sample));
        let inside = (0.25 * length.abs()).min(2.0 * self.same(now));
        let (first, last) = (now.min(now + length), now.max(now + length));
        (set, load, [first - t.t_d + inside, last - t.t_d - inside])
    }

    /// The inputs now, behind what has happened now, before what has not.
    #[inline(always)]
    pub(super) fn here(&self) -> Stretch {
        let same = 4.0 * self.same(self.now.value());
        let broken = (self.now.value() - self.broken).abs() <= same;
        self.stretch(if broken { same } else { -same })
    }

    /// All signals now.
    #[inline(always)]
    pub(super) fn flow_now(&self) -> Flow<Dual<S, N>> {
        self.flow_in(self.here())
    }

    #[inline(always)]
    pub(super) fn flow_in(&self, (set, load, within): Stretch) -> Flow<Dual<S, N>> {
        let inputs = Inputs { set, load, held: self.held, past: &self.past, within };
        self.flow_of(&inputs, self.now, &self.state)
    }

    /// All signals at a time and in a state.
    #[inline(always)]
    pub(super) fn flow_of(
        &self,
        inputs: &Inputs<'_, Dual<S, N>>,
        time: Dual<S, N>,
        state: &State<Dual<S, N>>,
    ) -> Flow<Dual<S, N>> {
        let (equations, mode) = (&self.equations, self.mode);
        self.now.apart(FlowAt { equations, inputs, time, state, mode })
    }

    /// On to a time, before anything happens there; false where a switch has made something that happens before.
    #[inline(always)]
    fn move_to(&mut self, time: Dual<S, N>) -> Result<bool> {
        let length = time - self.now;
        if length.value() <= 2.0 * self.same(time.value()) {
            let flow = self.flow_now();
            self.state = self.state.after(length, &flow.rates);
            self.now = time;
            return Ok(true);
        }
        let stretch = self.stretch(length.value());
        let parts = (length.value() / self.longest * (1.0 - SAME)).ceil().max(1.0);
        let (start, part) = (self.now, length * (1.0 / parts));
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // At most MOST_STEPS.
        for number in 0..parts as usize {
            self.steps += 1;
            if self.steps.is_multiple_of(LOOK_EVERY) {
                self.stop.check()?;
            }
            self.now = start + part * number as f64;
            if !self.advance(stretch, part) || self.breaks_before(time.value()) {
                return Ok(false);
            }
        }
        self.now = time;
        if self.equations.elements.delayed {
            self.past.forget(time.value() - self.plain.terms.t_d - self.longest);
        }
        Ok(true)
    }

    /// Through a step, switch by switch; false where it ends early, since a switch has broken a command that arrives within.
    #[inline(always)]
    fn advance(&mut self, stretch: Stretch, length: Dual<S, N>) -> bool {
        let mut left = length;
        if self.equations.elements.watched() {
            for _ in 0..MOST_SWITCHES {
                let foreseen = self.foresee(stretch, left);
                let switch = self.first_switch(stretch, left.value());
                let passed = switch.map(|switch| self.located(stretch, left, &switch));
                if foreseen {
                    self.past.pop();
                }
                let (Some(switch), Some(passed)) = (switch, passed) else { break };
                self.step(stretch, passed);
                self.switch(stretch, &switch);
                left = left - passed;
                if left.value() <= 1e-14 * length.value() {
                    break;
                }
                self.switches += 1;
                if self.switches < MOST_SWITCHES && self.breaks_before(self.now.value() + left.value()) {
                    return false;
                }
            }
        }
        self.step(stretch, left);
        true
    }
}
