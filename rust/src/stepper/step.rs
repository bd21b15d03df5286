//! A step of the ship, with third order for the speed.

use crate::subnormal::cut;

use super::command::{Clock, DeadTime};
use super::constants::{Acting, Constants, Lag};
use super::detail::Detail;
use super::envelope::Envelope;
use super::inputs::{Input, Span};
use super::law::Law;
use super::output::Output;
use super::parameters::{Parameters, at};
use super::run::Run;
use super::shaft::Twist;

/// Range of the relative speed, outside which a simulation ends.
const SLOWEST: f64 = 0.01;
const FASTEST: f64 = 20.0;
/// Rack position beyond which a simulation has diverged.
const FARTHEST: f64 = 1e6;

/// Second-order prediction of a step's end.
#[derive(Clone, Copy)]
pub struct Ahead {
    /// Engine speed, and its change over the step.
    pub speed: f64,
    pub rise: f64,
    /// Torque against the engine; used only by the governor's derivative.
    pub against: f64,
}

/// State of the ship between two steps.
///
/// `D`: with the additional elements of a whole drive train.
pub struct Ship<'a, const D: bool> {
    pub(super) c: Constants,
    pub(super) acting: Acting,
    pub(super) envelope: Option<&'a Envelope>,
    pub(super) detail: Option<Box<Detail>>,
    channel_delays: [f64; 2],
    pub(super) set: Input<'a>,
    load: Input<'a>,
    pub(super) law_of: Law,
    pub(super) dead_time: DeadTime,
    /// Dead time of the loop [s], and share of a command at a step's end that reaches the rack at once.
    pub(super) late: f64,
    pub(super) at_once: f64,
    pub(super) clock: Option<Box<Clock>>,
    pub(super) twist: Option<Box<Twist>>,
    /// Active side of the torque limit at the step's beginning, and whether the integral is frozen during the step.
    held: i8,
    pub(super) winds_up: bool,
    pub(super) h: f64,
    pub(super) at: usize,
    pub(super) speed: f64,
    /// Speed behind the governor's filter.
    pub(super) filtered: f64,
    pub(super) sum: f64,
    pub(super) rack: f64,
    /// Rack that corresponds to the engine's present torque: behind the engine's lag, including the slope behind this
    /// lag.
    pub(super) burnt: f64,
    /// Rack before an input jumps.
    pub(super) lagged: f64,
    /// Load law at the present speed, and the speed-dependent engine torque minus the load law.
    pub(super) law: f64,
    own: f64,
    /// Changes of the acceleration and of `own` (the speed-dependent torque) over the last step.
    pub(super) growth: f64,
    own_growth: f64,
    /// Command at the end of the last step, and at the beginning of this step.
    command: f64,
    pub(super) start: f64,
    /// Acceleration at the end of the last step, and at the beginning of this step.
    pub(super) ended: f64,
    pub(super) acceleration: f64,
    pub(super) set_span: Span,
    load_span: Span,
}

impl<'a, const D: bool> Ship<'a, D> {
    /// The ship in steady state before a record.
    pub fn new(parameters: &Parameters, run: &Run<'a>) -> Self {
        let h = run.step();
        let c = Constants::new(parameters, h);
        let acting = Acting::new(parameters, run);
        let scale = acting.scale.then(|| (parameters.of(at::S_U), parameters.of(at::U_0)));
        let set = Input::new(run.set, run, parameters.of(at::T_SET), scale);
        let load = Input::new(run.load, run, 0.0, None);
        let mut law_of = Law::new(
            parameters.of(at::P),
            acting.curvature.then(|| parameters.of(at::CURVATURE)),
            acting.damping.then(|| parameters.of(at::DAMPING)),
        );
        let (speed, rack) = (parameters.of(at::INITIAL_N), parameters.of(at::INITIAL_F) / c.v);
        let dead_time =
            DeadTime::new(parameters.of(at::T_D), acting.hold.then(|| parameters.of(at::HOLD)), h, rack);
        let detail = run.detail.cloned().map(Box::new);
        let law = match &detail {
            Some(detail) if D => detail.propeller.mean_load(&mut law_of, speed)[0],
            _ => law_of.at(speed)[0],
        };
        let at_firings = detail.as_ref().is_some_and(|detail| detail.once_a_firing);
        let mut ship = Self {
            at_once: dead_time.at_once() * c.lag.follows,
            dead_time,
            late: parameters.of(at::T_D),
            clock: Clock::new(parameters, rack, at_firings).map(Box::new),
            twist: None,
            held: 0,
            winds_up: false,
            h,
            at: 0,
            speed,
            filtered: speed,
            sum: 0.0,
            rack,
            burnt: rack + c.late_g * (speed - 1.0) / c.v,
            lagged: rack,
            law,
            own: c.g * (speed - 1.0) - law,
            growth: 0.0,
            own_growth: 0.0,
            command: rack,
            start: rack,
            ended: 0.0,
            acceleration: 0.0,
            set_span: set.first(),
            load_span: if acting.load { load.first() } else { Span::default() },
            channel_delays: [parameters.of(at::T_N), parameters.of(at::T_M)],
            law_of,
            detail,
            c,
            acting,
            envelope: run.envelope,
            set,
            load,
        };
        ship.rest(parameters);
        ship
    }

    /// Set the state before a record. It is steady at the first sample if the initial values allow it.
    fn rest(&mut self, parameters: &Parameters) {
        let against = self.law_with_load(self.load_span.start);
        let excess = if D { against * 0.0 } else { self.engine(self.speed, self.burnt).0 - against };
        self.ended = excess * self.c.inverse_tau;
        // The shaft transmits the torque of the propeller's side at the common acceleration.
        let spring = against + self.c.tau_prop * self.ended;
        self.twist = Twist::new(parameters, self.h, [self.speed, spring]).map(Box::new);
        let error = self.set_span.start - self.speed;
        if parameters.of(at::K_I) != 0.0 && !D {
            self.sum = (self.rack - self.commanded(error, self.sum, self.ended)) / self.c.k_i;
        }
        self.sum += parameters.of(at::INITIAL_E);
        if D {
            self.rest_detail();
        }
        self.command = self.commanded(error, self.sum, self.ended);
        self.begin();
    }

    /// Whether the state is plausible, so that the simulation can continue.
    pub fn is_sound(&self) -> bool {
        self.speed > SLOWEST && self.speed < FASTEST && self.rack.abs() < FARTHEST
    }

    /// Delays of the speed and torque sensors, if any.
    pub fn channel_delays(&self) -> Option<[f64; 2]> {
        self.acting.channels.then_some(self.channel_delays)
    }

    /// Output at the beginning of the step.
    #[inline(always)]
    pub fn output(&self, output: Output) -> f64 {
        match output {
            Output::Speed => self.speed - 1.0,
            Output::PropellerSpeed => self.twist.as_ref().map_or(self.speed, |twist| twist.propeller) - 1.0,
            Output::EngineTorque => self.c.s_m * self.braked() - 1.0,
            Output::GaugeTorque => self.c.s_m * self.gauge() - 1.0,
            Output::Rack => self.rack,
            Output::Sum => self.sum,
        }
    }

    #[inline(always)]
    fn gauge(&self) -> f64 {
        match &self.twist {
            Some(twist) => twist.torque(self.speed),
            None => self.law_with_load(self.load_span.start) + self.c.tau_prop * self.acceleration,
        }
    }

    #[inline(always)]
    pub(super) fn law_with_load(&self, load: f64) -> f64 {
        if self.acting.load { self.law + load * self.c.load_gain } else { self.law }
    }

    /// Evaluate inputs and acceleration at the step's beginning.
    #[inline(always)]
    fn begin(&mut self) {
        if self.at > 0 {
            self.set_span = self.set.over(self.at, self.set_span.end);
            if self.acting.load {
                self.load_span = self.load.over(self.at, self.load_span.end);
            }
        }
        self.start = self.command;
        self.acceleration = self.ended;
        if D || self.acting.jumps || self.at == 0 {
            self.jump();
        }
        if self.acting.torque_limit {
            self.held = self.engine(self.speed, self.burnt).1;
        }
    }

    /// Apply the immediate effect of jumps of the inputs.
    #[inline(always)]
    fn jump(&mut self) {
        let against = match &self.twist {
            Some(twist) => twist.torque(self.speed),
            None => self.law_with_load(self.load_span.start),
        };
        let error = self.set_span.start - self.seen();
        if self.acting.at_once && self.clock.is_none() {
            let mut command = self.commanded(error, self.sum, 0.0);
            if self.acting.derivative {
                let acceleration = self.brought_about(self.speed, command, against, self.c.k_d);
                command -= self.c.k_d * acceleration;
            }
            self.rack = self.within_limits(self.dead_time.over(self.at, command, command).start);
            if !self.acting.charge {
                self.burnt = self.rack;
            }
        }
        let torque = self.driving() - against;
        self.acceleration = match &self.twist {
            Some(twist) => torque * twist.inverse,
            None => torque * self.c.inverse_tau,
        };
        if self.clock.is_none() {
            self.start = self.commanded(error, self.sum, self.acceleration);
        }
    }

    /// Acceleration of the shaft if the rack depends on it: the rack is `order` minus `fuel` times the acceleration.
    #[inline(always)]
    pub(super) fn brought_about(&self, speed: f64, order: f64, against: f64, fuel: f64) -> f64 {
        if self.acting.charge {
            return self.acceleration + self.growth;
        }
        let (torque, held) = self.engine(speed, self.within_limits(order));
        let inertia = 1.0 / self.twist.as_ref().map_or(self.c.inverse_tau, |twist| twist.inverse);
        let more = if held == 0 { fuel * self.c.v } else { 0.0 };
        (torque - against) / (inertia + more)
    }

    /// Whether the integral is frozen: a limit is active, and the error would drive the command further.
    #[inline(always)]
    pub(super) fn stands(&self, command: f64, error: f64) -> bool {
        if !self.acting.anti_windup {
            return false;
        }
        let rack_side = i8::from(command > self.c.rack_most) - i8::from(command < self.c.rack_least);
        let late = self.c.late_g * (self.speed - 1.0) / self.c.v;
        let torque_side = self.engine(self.speed, command + late).1;
        f64::from(if torque_side == 0 { rack_side } else { torque_side }) * error > 0.0
    }

    /// Advance to the next step's beginning.
    #[inline(always)]
    pub fn step(&mut self) {
        if self.clock.is_none() {
            self.winds_up = self.stands(self.start, self.set_span.start - self.seen());
        }
        let rise = self.acceleration * self.h + self.growth * (0.5 * self.h);
        let speed = self.speed + rise;
        if D {
            self.detailed(Ahead { speed, rise, against: speed });
        } else if let Some(twist) = self.twist.take() {
            self.twisted(twist, Ahead { speed, rise, against: speed });
        } else {
            self.rigid(Ahead { speed, rise, against: speed });
        }
        if self.clock.is_none() {
            self.command = self.commanded(self.set_span.end - self.seen(), self.sum, self.ended);
            self.dead_time.keep(self.at, self.start, self.command);
        }
        self.at += 1;
        self.begin();
    }

    /// Rack that corresponds to the engine's torque at the step's end, and its mean. The rack itself moves to the step's
    /// end.
    #[inline(always)]
    pub(super) fn driven(&mut self, ahead: &Ahead) -> [f64; 2] {
        let [rack, mean] = if self.clock.is_some() { self.clocked() } else { self.fed(ahead) };
        (self.rack, self.lagged) = (rack, rack);
        if !self.acting.charge {
            return [rack, mean];
        }
        let slope = self.c.late_g / self.c.v;
        let apart = 0.5 * (self.speed + ahead.speed) - self.growth * (self.h / 12.0) - 1.0;
        let mean = mean + slope * apart;
        let burnt = self.c.charge.over(self.burnt, rack + slope * (ahead.speed - 1.0), mean);
        [burnt, mean + (self.burnt - burnt) * self.c.charge.in_steps]
    }

    /// Step of a single inertia.
    #[inline(always)]
    fn rigid(&mut self, mut ahead: Ahead) {
        let begin = (self.law, self.burnt);
        let [law_ahead, slope] = self.law_of.at(ahead.speed);
        if self.acting.derivative {
            self.law = law_ahead;
            ahead.against = self.law_with_load(self.load_span.end);
        }
        let [rack, mean_rack] = self.driven(&ahead);
        let apart = ahead.speed - 1.0;
        // Speed-dependent torque without the fuel, corrected to third order.
        let own_ahead = self.c.g * apart - law_ahead;
        let growth = own_ahead - self.own;
        let fuel = self.fuel(rack) + 1.0;
        let is_free = !self.acting.torque_limit
            || self.held == 0 && self.within_torque(fuel + self.c.g * apart, apart).1 == 0;
        let mut mean = if is_free {
            self.fuel(mean_rack) + self.own + 1.0 + growth * (5.0 / 12.0) + self.own_growth * (1.0 / 12.0)
        } else {
            let torques = self.engine(self.speed, begin.1).0 + self.engine(ahead.speed, rack).0;
            (torques - begin.0 - law_ahead) * 0.5
        };
        self.own_growth = growth;
        if self.acting.load {
            mean -= self.load_span.mean * self.c.load_gain;
        }
        let speed = self.speed + mean * self.c.step_over_tau;
        let more = speed - ahead.speed;
        self.law = law_ahead + more * slope;
        self.own = own_ahead + more * (self.c.g - slope);
        let ended =
            if self.acting.torque_limit { self.engine(speed, rack).0 - self.law } else { fuel + self.own };
        let load = self.load_span.end;
        let ended = if self.acting.load { ended - load * self.c.load_gain } else { ended };
        self.arrived(speed, ended * self.c.inverse_tau, more, rack);
    }

    /// Step of two inertias on a torsionally flexible shaft.
    #[inline(always)]
    fn twisted(&mut self, mut twist: Box<Twist>, mut ahead: Ahead) {
        let torque = twist.torque(self.speed);
        ahead.against = torque + twist.torque_growth;
        self.twist = Some(twist);
        let [rack, mean_rack] = self.driven(&ahead);
        let Some(taken) = self.twist.take() else { return };
        twist = taken;
        let start = self.engine(self.speed, mean_rack * 2.0 - rack).0;
        let end = self.engine(ahead.speed, rack).0;
        let load = self.law_with_load(self.load_span.start);
        let pace = (torque - load) * twist.inverse_prop;
        let propeller_ahead = twist.propeller + pace * self.h + twist.propeller_growth * (0.5 * self.h);
        let [law_ahead, slope] = self.law_of.at(propeller_ahead);
        self.law = law_ahead;
        let loads = [load, self.law_with_load(self.load_span.end)];
        let speed = twist.go(self.speed, [start, end], loads);
        self.law = law_ahead + (twist.propeller - propeller_ahead) * slope;
        let after = twist.torque(speed);
        twist.torque_growth = after - torque;
        twist.propeller_growth = (after - self.law_with_load(self.load_span.end)) * twist.inverse_prop - pace;
        let ended = (self.engine(speed, rack).0 - after) * twist.inverse;
        self.twist = Some(twist);
        self.arrived(speed, ended, speed - ahead.speed, rack);
    }

    /// Finish a step at a speed that exceeds the prediction by `more`.
    #[inline(always)]
    pub(super) fn arrived(&mut self, speed: f64, ended: f64, more: f64, burnt: f64) {
        let h = self.h;
        let foreseen = self.seen_after(speed - more);
        self.growth = ended - self.acceleration;
        let seen = self.seen_after(speed);
        if self.clock.is_none() && !self.winds_up {
            self.sum = self.sum - more * (0.5 * h) + self.growth * (h * h / 12.0);
            self.sum += self.c.filter.time * (seen - foreseen);
        }
        self.filtered = seen;
        (self.speed, self.ended, self.burnt) = (speed, ended, burnt);
    }

    /// Speed that the governor sees.
    #[inline(always)]
    pub(super) fn seen(&self) -> f64 {
        if self.acting.filter { self.filtered } else { self.speed }
    }

    /// Speed that the governor sees at the step's end, if the speed is `end` there.
    #[inline(always)]
    pub(super) fn seen_after(&self, end: f64) -> f64 {
        if !self.acting.filter {
            return end;
        }
        let mean = 0.5 * (self.speed + end) - self.growth * (self.h / 12.0);
        self.c.filter.over(self.filtered, end, mean)
    }

    /// Speed that the governor sees within a step, `since` seconds after the step's beginning.
    #[inline(always)]
    pub(super) fn seen_within(&self, speed: f64, since: f64) -> f64 {
        if !self.acting.filter || since <= 0.0 {
            return if self.acting.filter { self.filtered } else { speed };
        }
        Lag::new(self.c.filter.time, since).over(self.filtered, speed, 0.5 * (self.speed + speed))
    }

    /// Set decayed values to zero: subnormal numbers would slow down every step.
    pub fn cut(&mut self) {
        for number in [
            &mut self.speed,
            &mut self.filtered,
            &mut self.sum,
            &mut self.rack,
            &mut self.burnt,
            &mut self.lagged,
            &mut self.law,
            &mut self.own,
            &mut self.growth,
            &mut self.own_growth,
            &mut self.command,
            &mut self.start,
            &mut self.ended,
            &mut self.acceleration,
        ] {
            *number = cut(*number);
        }
        self.dead_time.cut();
        if let Some(detail) = &mut self.detail {
            detail.cut();
        }
        if let Some(twist) = &mut self.twist {
            twist.cut();
        }
    }
}
