//! The equations of motion between two switches.

use crate::scalar::{Scalar, smaller};

use super::terms::{Elements, Integral, Mode, Side, Terms};

/// State of the drive train, or its rate of change.
#[derive(Debug, Clone, Copy)]
pub struct State<T> {
    /// Speed of the engine.
    pub engine: T,
    /// Speed of the propeller, of a flexible shaft.
    pub propeller: T,
    /// Torque of the shaft's spring.
    pub spring: T,
    /// The governor's sum of errors [s].
    pub sum: T,
    /// Rack behind the actuator, where that has a lag or its rate is limited.
    pub rack: T,
}

impl<T: Scalar> State<T> {
    /// The state after `time` at a constant `rate`.
    #[inline(always)]
    pub fn after(&self, time: T, rate: &Self) -> Self {
        Self {
            engine: self.engine + rate.engine * time,
            propeller: self.propeller + rate.propeller * time,
            spring: self.spring + rate.spring * time,
            sum: self.sum + rate.sum * time,
            rack: self.rack + rate.rack * time,
        }
    }

    /// Each entry through a function.
    #[inline(always)]
    pub fn map<U>(&self, of: impl Fn(T) -> U) -> State<U> {
        State {
            engine: of(self.engine),
            propeller: of(self.propeller),
            spring: of(self.spring),
            sum: of(self.sum),
            rack: of(self.rack),
        }
    }
}

/// What acts on the drive train at an instant, and how fast it changes.
#[derive(Debug, Clone, Copy)]
pub struct Input<T> {
    /// Set point at the governor.
    pub set: T,
    pub set_slope: T,
    /// Load torque.
    pub load: T,
    pub load_slope: T,
    /// Command that arrives at the actuator; of no meaning where that is the one just computed.
    pub command: T,
    pub command_slope: T,
}

/// All signals at an instant.
#[derive(Debug, Clone, Copy)]
pub struct Flow<T> {
    pub rates: State<T>,
    /// The governor's command and its slope.
    pub command: T,
    pub command_slope: T,
    /// What arrives at the actuator, before any limit, and its slope.
    pub asked: T,
    pub asked_slope: T,
    /// The rack.
    pub rack: T,
    /// Brake torque before its limits, and behind.
    pub raw: T,
    pub brake: T,
    /// Torque at the gauge.
    pub gauge: T,
    /// Error of the speed.
    pub miss: T,
}

/// The drive train's equations.
#[derive(Debug, Clone, Copy)]
pub struct Equations<T> {
    pub terms: Terms<T>,
    pub elements: Elements,
    /// Command without any error where no sum can hold it.
    pub bias: T,
}

/// Torques at the two ends of the shaft.
struct Shaft<T> {
    /// What stands against the brake torque, over the inertia that this drives.
    opposing: T,
    per_inertia: T,
    load: T,
    /// Rate of the propeller's speed and of the spring, of a flexible shaft.
    propeller_rate: T,
    spring_rate: T,
}

impl<T: Scalar> Equations<T> {
    /// From parameters, elements, and the first samples of the set point and the load.
    #[inline(always)]
    pub fn new(terms: Terms<T>, elements: Elements, first_set: f64, first_load: f64) -> Self {
        let bias = terms.g.constant(0.0);
        let equations = Self { terms, elements, bias };
        let standing = equations.standing(first_set, first_load);
        Self { bias: if terms.k_i.value() == 0.0 { standing } else { bias }, ..equations }
    }

    /// What the sum must add to the first command to make it the rack.
    #[inline(always)]
    fn standing(&self, first_set: f64, first_load: f64) -> T {
        let t = &self.terms;
        let (speed, load) = (t.initial_speed, t.load_gain * first_load);
        let standing = t.initial_fuel / t.v - t.k_p * (t.s_u * first_set - speed);
        if !self.elements.derivative {
            return standing;
        }
        let inertia = if self.elements.flexible { t.tau_n - t.tau_prop } else { t.tau_n };
        let torque = t.g * (speed + -1.0) + t.initial_fuel + 1.0;
        standing + t.k_d * (torque - self.load_torque(speed, load)) / inertia
    }

    /// The state from which a record starts: the shaft's twist as if all had stood so for long.
    #[inline(always)]
    pub fn start(&self, first_set: f64, first_load: f64) -> State<T> {
        let t = &self.terms;
        let standing = self.standing(first_set, first_load);
        let sum = if t.k_i.value() == 0.0 { t.k_i.constant(0.0) } else { standing / t.k_i };
        let spring = self.load_torque(t.initial_speed, t.load_gain * first_load);
        let rack = t.initial_fuel / t.v;
        State { engine: t.initial_speed, propeller: t.initial_speed, spring, sum, rack }
    }

    /// Whether the rack is an entry of the state.
    #[inline(always)]
    pub fn rack_is_state(&self, mode: Mode) -> bool {
        self.elements.lag || mode.rate != Side::Free
    }

    #[inline(always)]
    fn load_torque(&self, speed: T, load: T) -> T {
        speed.power(self.terms.p) + self.terms.damping * (speed + -1.0) + load
    }

    /// How fast the load torque rises with the speed.
    #[inline(always)]
    fn load_slope(&self, speed: T) -> T {
        if speed.value() == 0.0 {
            return self.terms.damping;
        }
        speed.power(self.terms.p) * self.terms.p / speed + self.terms.damping
    }

    /// The torque limit above and below at an engine speed.
    #[inline(always)]
    pub fn torque_limit(&self, side: Side, speed: T) -> T {
        match side {
            Side::High => self.terms.m_max + self.terms.m_max_slope * (speed + -1.0),
            _ => self.terms.m_min,
        }
    }

    #[inline(always)]
    fn shaft(&self, at: &Input<T>, state: &State<T>) -> Shaft<T> {
        let t = &self.terms;
        let one = t.g.constant(1.0);
        if !self.elements.flexible {
            let load = self.load_torque(state.engine, at.load);
            let zero = t.g.constant(0.0);
            return Shaft {
                opposing: load,
                per_inertia: one / t.tau_n,
                load,
                propeller_rate: zero,
                spring_rate: zero,
            };
        }
        let slip = state.engine - state.propeller;
        let twisting = state.spring + t.zeta_twist * slip;
        let load = self.load_torque(state.propeller, at.load);
        Shaft {
            opposing: twisting,
            per_inertia: one / (t.tau_n - t.tau_prop),
            load,
            propeller_rate: (twisting - load) / t.tau_prop,
            spring_rate: slip / t.tau_twist,
        }
    }

    /// How fast what stands against the brake torque changes.
    #[inline(always)]
    fn opposing_slope(&self, shaft: &Shaft<T>, at: &Input<T>, state: &State<T>, engine_rate: T) -> T {
        if self.elements.flexible {
            shaft.spring_rate + self.terms.zeta_twist * (engine_rate - shaft.propeller_rate)
        } else {
            self.load_slope(state.engine) * engine_rate + at.load_slope
        }
    }

    #[inline(always)]
    fn within_rack_limits(&self, mode: Mode, asked: T) -> T {
        match mode.rack {
            Side::Free => asked,
            Side::High => self.terms.x_max,
            Side::Low => self.terms.x_min,
        }
    }

    /// Brake torque before its limits, and behind.
    #[inline(always)]
    fn torques(&self, mode: Mode, speed: T, rack: T) -> (T, T) {
        let raw = self.terms.g * (speed + -1.0) + self.terms.v * rack + 1.0;
        match mode.torque {
            Side::Free => (raw, raw),
            side => (raw, self.torque_limit(side, speed)),
        }
    }

    /// The rack where it follows the command at once; the derivative of the speed in it depends on the rack itself.
    #[inline(always)]
    fn rack_at_once(&self, mode: Mode, base: T, shaft: &Shaft<T>, speed: T) -> T {
        if mode.rack != Side::Free || !self.elements.derivative {
            return self.within_rack_limits(mode, base);
        }
        let gain = self.terms.k_d * shaft.per_inertia;
        if mode.torque == Side::Free {
            let without = self.terms.g * (speed + -1.0) + 1.0 - shaft.opposing;
            (base - gain * without) / (gain * self.terms.v + 1.0)
        } else {
            base - gain * (self.torque_limit(mode.torque, speed) - shaft.opposing)
        }
    }

    /// Everything at an instant.
    #[inline(always)]
    pub fn flow(&self, at: &Input<T>, state: &State<T>, mode: Mode) -> Flow<T> {
        let mut flow = self.solved(at, state, mode, None);
        let t_d = self.terms.t_d;
        if self.elements.direct() && !t_d.is_zero() {
            // A dead time that is off, or so short that the first order will do.
            let late = t_d * flow.command_slope * -1.0;
            flow = self.solved(at, state, mode, Some(late));
        }
        flow
    }

    #[inline(always)]
    fn solved(&self, at: &Input<T>, state: &State<T>, mode: Mode, late: Option<T>) -> Flow<T> {
        let (t, elements) = (&self.terms, &self.elements);
        let miss = at.set - state.engine;
        let base = t.k_p * miss + t.k_i * state.sum + self.bias;
        let shaft = self.shaft(at, state);
        let delayed = |command: T| late.map_or(command, |late| command + late);
        let rack = if self.rack_is_state(mode) {
            state.rack
        } else if elements.direct() {
            let rack = self.rack_at_once(mode, base, &shaft, state.engine);
            if mode.rack == Side::Free { delayed(rack) } else { rack }
        } else {
            self.within_rack_limits(mode, at.command)
        };
        let (raw, brake) = self.torques(mode, state.engine, rack);
        let engine_rate = (brake - shaft.opposing) * shaft.per_inertia;
        let command = if elements.derivative { base - t.k_d * engine_rate } else { base };
        let asked = if elements.direct() { delayed(command) } else { at.command };
        let rack_rate = self.rack_rate(mode, asked, state.rack);
        let zero = miss.constant(0.0);
        let sum_rate = match mode.integral {
            Integral::Runs if !elements.sampled => miss,
            _ => zero,
        };
        let gauge = if elements.flexible { shaft.opposing } else { shaft.load + t.tau_prop * engine_rate };
        let rates = State {
            engine: engine_rate,
            propeller: shaft.propeller_rate,
            spring: shaft.spring_rate,
            sum: sum_rate,
            rack: rack_rate,
        };
        let mut flow = Flow {
            rates,
            command,
            command_slope: zero,
            asked,
            asked_slope: at.command_slope,
            rack,
            raw,
            brake,
            gauge,
            miss,
        };
        if !elements.sampled {
            self.add_slopes(&mut flow, &shaft, at, state, mode);
        }
        flow
    }

    /// Rate of the rack where it is an entry of the state.
    #[inline(always)]
    fn rack_rate(&self, mode: Mode, asked: T, rack: T) -> T {
        match mode.rate {
            Side::High => self.terms.rate_up,
            Side::Low => self.terms.rate_down * -1.0,
            Side::Free if self.elements.lag => {
                (self.within_rack_limits(mode, asked) - rack) / self.terms.tau_act
            }
            Side::Free => rack.constant(0.0),
        }
    }

    /// Slopes of a continuous governor's command, and what its sum does where it slides.
    #[inline(always)]
    fn add_slopes(&self, flow: &mut Flow<T>, shaft: &Shaft<T>, at: &Input<T>, state: &State<T>, mode: Mode) {
        let (t, elements) = (&self.terms, &self.elements);
        let engine_rate = flow.rates.engine;
        let mut slope = t.k_p * (at.set_slope - engine_rate) + t.k_i * flow.rates.sum;
        if elements.derivative {
            let gain = t.k_d * shaft.per_inertia;
            let by_speed = match mode.torque {
                Side::Free => t.g * engine_rate,
                Side::High => t.m_max_slope * engine_rate,
                Side::Low => engine_rate.constant(0.0),
            };
            let opposing = self.opposing_slope(shaft, at, state, engine_rate);
            slope = slope - gain * (by_speed - opposing);
            if mode.torque == Side::Free {
                if self.rack_is_state(mode) {
                    slope = slope - gain * t.v * flow.rates.rack;
                } else if mode.rack == Side::Free {
                    if elements.direct() {
                        slope = slope / (gain * t.v + 1.0);
                    } else {
                        slope = slope - gain * t.v * at.command_slope;
                    }
                }
            }
        }
        if let Integral::Slides(side) = mode.integral {
            let ceiling = self.ceiling_slope(side, state.engine, engine_rate);
            flow.rates.sum = (ceiling - slope) / t.k_i;
            slope = ceiling;
        }
        flow.command_slope = slope;
        if elements.direct() {
            flow.asked_slope = slope;
        }
    }

    /// The command beyond which the rack or the torque is limited, by the rack's own limit and by the torque's.
    #[inline(always)]
    fn ceilings(&self, side: Side, speed: T) -> (T, T) {
        let t = &self.terms;
        let (own, torque) = match side {
            Side::High => (t.x_max, t.m_max),
            _ => (t.x_min, t.m_min),
        };
        if torque.value().is_infinite() {
            return (own, torque);
        }
        let without = t.g * (speed + -1.0) + 1.0;
        (own, (self.torque_limit(side, speed) - without) / t.v)
    }

    /// Whether it is the torque that limits the command at a speed.
    #[inline(always)]
    pub fn torque_binds(&self, side: Side, speed: T) -> bool {
        let (own, torque) = self.ceilings(side, speed);
        if side == Side::High { torque.value() < own.value() } else { torque.value() > own.value() }
    }

    /// The command beyond which a limit holds it, at an engine speed.
    #[inline(always)]
    pub fn ceiling(&self, side: Side, speed: T) -> T {
        let (own, torque) = self.ceilings(side, speed);
        if side == Side::High {
            smaller(torque, own)
        } else if torque.value() > own.value() {
            torque
        } else {
            own
        }
    }

    /// How fast the ceiling moves.
    #[inline(always)]
    pub fn ceiling_slope(&self, side: Side, speed: T, engine_rate: T) -> T {
        let t = &self.terms;
        if !self.torque_binds(side, speed) {
            return speed.constant(0.0);
        }
        let zero = speed.constant(0.0);
        let limit = if side == Side::High { t.m_max_slope } else { zero };
        (limit - t.g) * engine_rate / t.v
    }
}
