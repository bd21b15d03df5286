//! One step of the ship, in numbers with or without derivatives.

use crate::scalar::Scalar;

use super::command::{Clock, DeadTime};
use super::constants::{Acting, Constants};
use super::detail::Detail;
use super::envelope::Envelope;
use super::inputs::{Input, Span};
use super::law::Law;
use super::output::Output;
use super::parameters::{Parameters, at};
use super::run::Run;
use super::shaft::Twist;

/// Speeds outside these, over the operating point's, end a simulation.
const SLOWEST: f64 = 0.01;
const FASTEST: f64 = 20.0;
/// A rack beyond this has run away.
const FARTHEST: f64 = 1e6;

/// What a predictor of second order says of a step's end.
#[derive(Clone, Copy)]
pub struct Ahead<T> {
    /// The engine's speed, and its rise over the step.
    pub speed: T,
    pub rise: T,
    /// Torque that stands against the engine's; only where the governor asks for it.
    pub against: T,
}

/// The ship between two steps.
///
/// `D`: with what only a whole drive train has.
pub struct Ship<'a, T, const D: bool> {
    pub(super) c: Constants<T>,
    pub(super) acting: Acting,
    pub(super) envelope: Option<&'a Envelope>,
    pub(super) detail: Option<Box<Detail>>,
    channel_delays: [T; 2],
    pub(super) set: Input<'a, T>,
    load: Input<'a, T>,
    pub(super) law_of: Law<T>,
    pub(super) dead_time: DeadTime<T>,
    /// Dead time in the loop [s], and the part of a command at a step's end that reaches the rack by then.
    pub(super) late: T,
    pub(super) at_once: T,
    pub(super) clock: Option<Box<Clock<T>>>,
    pub(super) twist: Option<Box<Twist<T>>>,
    /// Side of the torque limit that holds as the step begins, and whether the sum stands over it.
    held: i8,
    pub(super) winds_up: bool,
    pub(super) h: f64,
    pub(super) at: usize,
    pub(super) speed: T,
    pub(super) sum: T,
    pub(super) rack: T,
    /// The rack before an input that jumps.
    pub(super) lagged: T,
    /// The load's law at the present speed, and what the engine gains on it by the speed alone.
    pub(super) law: T,
    own: T,
    /// Growth of the acceleration, and of `own`, over the last step.
    pub(super) growth: T,
    own_growth: T,
    /// The command at the end of the last step, and at the begin of this one.
    command: T,
    pub(super) start: T,
    /// Acceleration at the end of the last step, and at the begin of this one.
    pub(super) ended: T,
    pub(super) acceleration: T,
    pub(super) set_span: Span<T>,
    load_span: Span<T>,
}

impl<'a, T: Scalar, const D: bool> Ship<'a, T, D> {
    /// At rest before a record; `number` gives each parameter as a number with its derivative.
    pub fn new(parameters: &Parameters, run: &Run<'a>, wrt: &[usize], number: impl Fn(usize) -> T) -> Self {
        let h = run.step();
        let c = Constants::new(&number, h);
        let acting = Acting::new(parameters, run, wrt);
        let zero = c.g.constant(0.0);
        let set = Input::new(
            run.set,
            run,
            number(at::T_SET),
            acting.scale.then(|| (number(at::S_U), number(at::U_0))),
        );
        let load = Input::new(run.load, run, zero, None);
        let mut law_of = Law::new(
            number(at::P),
            acting.curvature.then(|| number(at::CURVATURE)),
            acting.damping.then(|| number(at::DAMPING)),
        );
        let (speed, rack) = (number(at::INITIAL_N), number(at::INITIAL_F) / c.v);
        let still = Span { start: zero, end: zero, mean: zero };
        let dead_time = DeadTime::new(number(at::T_D), acting.hold.then(|| number(at::HOLD)), h, rack);
        let detail = run.detail.cloned().map(Box::new);
        let law = match &detail {
            Some(detail) if D => zero.constant(detail.propeller.mean_load(&mut law_of, speed)[0]),
            _ => law_of.at(speed)[0],
        };
        let at_firings = detail.as_ref().is_some_and(|detail| detail.once_a_firing);
        let mut ship = Self {
            at_once: dead_time.at_once() * c.lag.follows,
            dead_time,
            late: number(at::T_D),
            clock: Clock::new(parameters, &number, rack, at_firings).map(Box::new),
            twist: None,
            held: 0,
            winds_up: false,
            h,
            at: 0,
            speed,
            sum: zero,
            rack,
            lagged: rack,
            law,
            own: c.g * (speed + -1.0) - law,
            growth: zero,
            own_growth: zero,
            command: rack,
            start: rack,
            ended: zero,
            acceleration: zero,
            set_span: set.first(),
            load_span: if acting.load { load.first() } else { still },
            channel_delays: [number(at::T_N), number(at::T_M)],
            law_of,
            detail,
            c,
            acting,
            envelope: run.envelope,
            set,
            load,
        };
        ship.rest(parameters, &number);
        ship
    }

    /// The state before a record, which its first sample keeps as far as it can.
    fn rest(&mut self, parameters: &Parameters, number: &impl Fn(usize) -> T) {
        let against = self.law_with_load(self.load_span.start);
        let excess = if D { against * 0.0 } else { self.engine(self.speed, self.rack).0 - against };
        self.ended = excess * self.c.inverse_tau;
        // The shaft carries what the load's side takes at the common acceleration.
        let spring = against.plus_product(self.c.tau_prop, self.ended);
        self.twist = Twist::new(parameters, number, self.h, [self.speed, spring]).map(Box::new);
        let error = self.set_span.start - self.speed;
        if parameters.of(at::K_I) != 0.0 && !D {
            self.sum = (self.rack - self.commanded(error, self.sum, self.ended)) / self.c.k_i;
        }
        self.sum = self.sum + number(at::INITIAL_E);
        if D {
            self.rest_detail();
        }
        self.command = self.commanded(error, self.sum, self.ended);
        self.begin();
    }

    /// Whether the speed is still one that a ship may have.
    pub fn is_sound(&self) -> bool {
        let speed = self.speed.value();
        speed > SLOWEST && speed < FASTEST && self.rack.value().abs() < FARTHEST
    }

    /// Delays of the speed's and the torque's channel, where one is late.
    pub fn channel_delays(&self) -> Option<[T; 2]> {
        self.acting.channels.then_some(self.channel_delays)
    }

    /// What is seen at the begin of the step.
    #[inline(always)]
    pub fn output(&self, output: Output) -> T {
        match output {
            Output::Speed => self.speed + -1.0,
            Output::PropellerSpeed => self.twist.as_ref().map_or(self.speed, |twist| twist.propeller) + -1.0,
            Output::EngineTorque => self.c.s_m * self.braked() + -1.0,
            Output::GaugeTorque => self.c.s_m * self.gauge() + -1.0,
            Output::Rack => self.rack,
            Output::Sum => self.sum,
        }
    }

    #[inline(always)]
    fn gauge(&self) -> T {
        match &self.twist {
            Some(twist) => twist.torque(self.speed),
            None => self.law_with_load(self.load_span.start).plus_product(self.c.tau_prop, self.acceleration),
        }
    }

    #[inline(always)]
    pub(super) fn law_with_load(&self, load: T) -> T {
        if self.acting.load { self.law.plus_product(load, self.c.load_gain) } else { self.law }
    }

    /// Look at the step's inputs, and at the acceleration as it begins.
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
            self.held = self.engine(self.speed, self.rack).1;
        }
    }

    /// What inputs that jump bring about at once.
    #[inline(always)]
    fn jump(&mut self) {
        let against = match &self.twist {
            Some(twist) => twist.torque(self.speed),
            None => self.law_with_load(self.load_span.start),
        };
        let error = self.set_span.start - self.speed;
        if self.acting.at_once && self.clock.is_none() {
            let zero = error.constant(0.0);
            let mut command = self.commanded(error, self.sum, zero);
            if self.acting.derivative {
                let acceleration = self.brought_about(self.speed, command, against, self.c.k_d);
                command = command - self.c.k_d * acceleration;
            }
            self.rack = self.within_limits(self.dead_time.over(self.at, command, command).start);
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

    /// Acceleration where the rack is an order less `fuel` times the acceleration itself.
    #[inline(always)]
    pub(super) fn brought_about(&self, speed: T, order: T, against: T, fuel: T) -> T {
        let (torque, held) = self.engine(speed, self.within_limits(order));
        let inertia =
            self.c.g.constant(1.0) / self.twist.as_ref().map_or(self.c.inverse_tau, |twist| twist.inverse);
        let more = if held == 0 { fuel * self.c.v } else { inertia.constant(0.0) };
        (torque - against) / (inertia + more)
    }

    /// Whether the sum stands: the command is beyond what limits let through, and the error would drive it further.
    #[inline(always)]
    pub(super) fn stands(&self, command: T, error: T) -> bool {
        if !self.acting.anti_windup {
            return false;
        }
        let rack = command.value();
        let rack_side =
            i8::from(rack > self.c.rack_most.value()) - i8::from(rack < self.c.rack_least.value());
        let torque_side = self.engine(self.speed, command).1;
        f64::from(if torque_side == 0 { rack_side } else { torque_side }) * error.value() > 0.0
    }

    /// Go on to the next step's begin.
    #[inline(always)]
    pub fn step(&mut self) {
        if self.clock.is_none() {
            self.winds_up = self.stands(self.start, self.set_span.start - self.speed);
        }
        let rise = (self.acceleration * self.h).plus(self.growth, 0.5 * self.h);
        let speed = self.speed + rise;
        if D {
            self.detailed(Ahead { speed, rise, against: speed });
        } else if let Some(twist) = self.twist.take() {
            self.twisted(twist, Ahead { speed, rise, against: speed });
        } else {
            self.rigid(Ahead { speed, rise, against: speed });
        }
        if self.clock.is_none() {
            self.command = self.commanded(self.set_span.end - self.speed, self.sum, self.ended);
            self.dead_time.keep(self.at, self.start, self.command);
        }
        self.at += 1;
        self.begin();
    }

    /// The rack at the step's end, and its mean.
    #[inline(always)]
    pub(super) fn driven(&mut self, ahead: &Ahead<T>) -> [T; 2] {
        if self.clock.is_some() { self.clocked() } else { self.fed(ahead) }
    }

    /// One inertia.
    #[inline(always)]
    fn rigid(&mut self, mut ahead: Ahead<T>) {
        let begin = (self.law, self.rack);
        let [law_ahead, slope] = self.law_of.at(ahead.speed);
        if self.acting.derivative {
            self.law = law_ahead;
            ahead.against = self.law_with_load(self.load_span.end);
        }
        let [rack, mean_rack] = self.driven(&ahead);
        let apart = ahead.speed + -1.0;
        // What follows the speed, apart from the fuel: corrected to third order.
        let own_ahead = self.c.g * apart - law_ahead;
        let growth = own_ahead - self.own;
        let fuel = self.fuel(rack) + 1.0;
        let is_free = !self.acting.torque_limit
            || self.held == 0 && self.within_torque(fuel.plus_product(self.c.g, apart), apart).1 == 0;
        let mut mean = if is_free {
            (self.fuel(mean_rack) + self.own + 1.0).plus(growth, 5.0 / 12.0).plus(self.own_growth, 1.0 / 12.0)
        } else {
            let torques = self.engine(self.speed, begin.1).0 + self.engine(ahead.speed, rack).0;
            (torques - begin.0 - law_ahead) * 0.5
        };
        self.own_growth = growth;
        if self.acting.load {
            mean = mean - self.load_span.mean * self.c.load_gain;
        }
        let speed = self.speed.plus_product(mean, self.c.step_over_tau);
        let more = speed - ahead.speed;
        self.law = law_ahead.plus_product(more, slope);
        self.own = own_ahead.plus_product(more, self.c.g - slope);
        let ended =
            if self.acting.torque_limit { self.engine(speed, rack).0 - self.law } else { fuel + self.own };
        let load = self.load_span.end;
        let ended = if self.acting.load { ended - load * self.c.load_gain } else { ended };
        self.arrived(speed, ended * self.c.inverse_tau, more, rack);
    }

    /// Two inertias on a shaft that twists.
    #[inline(always)]
    fn twisted(&mut self, mut twist: Box<Twist<T>>, mut ahead: Ahead<T>) {
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
        let propeller_ahead = twist.propeller.plus(pace, self.h).plus(twist.propeller_growth, 0.5 * self.h);
        let [law_ahead, slope] = self.law_of.at(propeller_ahead);
        self.law = law_ahead;
        let loads = [load, self.law_with_load(self.load_span.end)];
        let speed = twist.go(self.speed, [start, end], loads);
        self.law = law_ahead.plus_product(twist.propeller - propeller_ahead, slope);
        let after = twist.torque(speed);
        twist.torque_growth = after - torque;
        twist.propeller_growth = (after - self.law_with_load(self.load_span.end)) * twist.inverse_prop - pace;
        let ended = (self.engine(speed, rack).0 - after) * twist.inverse;
        self.twist = Some(twist);
        self.arrived(speed, ended, speed - ahead.speed, rack);
    }

    /// The end of a step, at a speed that is `more` than was foreseen.
    #[inline(always)]
    pub(super) fn arrived(&mut self, speed: T, ended: T, more: T, rack: T) {
        let h = self.h;
        self.growth = ended - self.acceleration;
        if self.clock.is_none() && !self.winds_up {
            self.sum = self.sum.plus(more, -0.5 * h).plus(self.growth, h * h / 12.0);
        }
        (self.speed, self.ended, self.rack, self.lagged) = (speed, ended, rack, rack);
    }

    /// Take what has died away for zero: numbers below the normal ones would slow down every step.
    pub fn cut(&mut self) {
        for number in [
            &mut self.speed,
            &mut self.sum,
            &mut self.rack,
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
            *number = number.cut();
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
