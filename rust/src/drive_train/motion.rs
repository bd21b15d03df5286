//! The equations of motion of the drive train between two events.

use pulp::{Simd, WithSimd};

use crate::plant::{Engine, Envelope, Gearbox, Slope, limited};
use crate::scalar::{Scalar, smaller};

use super::firing::Firing;
use super::governor::{Ceiling, Command, Timing};
use super::ramp::Ramp;
use super::shaft::Shaft;
use super::ship::Ship;
use super::{Governor, Propeller, STATES, State};

/// Path of the command to the fuel rack.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Actuator<T = f64> {
    /// [s].
    pub dead_time: T,
    /// Time constant [s].
    pub lag: T,
    /// Of the rack [mm/s].
    pub rate: T,
}

/// All components and where they start.
#[derive(Debug, Clone)]
#[allow(missing_docs)]
pub struct DriveTrain<T = f64> {
    pub governor: Governor<T>,
    /// Dead time of the set point [s].
    pub set_dead_time: T,
    pub actuator: Actuator<T>,
    pub engine: Engine<T>,
    /// On the torque envelope.
    pub limit_factor: T,
    /// Fuel that the smoke limiter allows beyond what the charge air can burn [mm of rack].
    pub smoke_margin: T,
    /// Time constant of the charge air behind the rack [s].
    pub turbocharger_lag: T,
    /// Of the brake torque [Nm/s].
    pub torque_rate: T,
    /// [rev of the engine], zero for a torque without pulses.
    pub firing_interval: f64,
    pub firing_width: f64,
    pub strength: Vec<f64>,
    pub gearbox: Gearbox<T>,
    /// Torque lost at the shaft [Nm/(rev/s)^`drag_exponent`], beside the gearbox's efficiency.
    pub drag: T,
    pub drag_exponent: T,
    pub shaft: Shaft<T>,
    pub propeller: Propeller<T>,
    pub ship: Ship<T>,
    /// Shaft speed [rev/s].
    pub initial_speed: T,
    /// [rev].
    pub initial_error: T,
    /// [m/s].
    pub initial_ship_speed: T,
    /// Set point before the record [rev/s].
    pub set_point_before: T,
    /// At the first sample [rev].
    pub crank_angle: T,
}

/// The drive train's memory between steps.
#[derive(Debug, Clone)]
pub struct Memory<T = f64> {
    pub rack: Ramp<T>,
    pub torque: Ramp<T>,
    pub firing: Firing<T>,
    /// Command that a sampling governor holds [mm].
    pub held: T,
}

/// What acts on the drive train within a step.
#[derive(Debug, Clone, Copy)]
pub struct Instant<T = f64> {
    /// Time since the step began [s].
    pub elapsed: T,
    /// Set point at the governor [rev/s]; of no meaning where that computes at times of its own.
    pub set_speed: T,
    /// Command that comes out of the actuator's dead time [mm]; None: there is none.
    pub arriving: Option<T>,
}

/// Signals of the governor and of the fuel path at an instant.
#[derive(Debug, Clone, Copy)]
pub struct FuelPath<T = f64> {
    /// Of the governor.
    pub command: Command<T>,
    /// Behind the dead time, before its rate is limited [mm].
    pub fuel: T,
    /// [mm].
    pub rack: T,
    /// [mm/s].
    pub rack_rate: T,
    /// Mean brake torque before its rate is limited [Nm].
    pub demand: T,
}

/// All signals at an instant, and the rates of the state.
#[derive(Debug, Clone, Copy)]
pub struct Flow<T = f64> {
    /// Of the governor [mm].
    pub command: T,
    /// Mean brake torque [Nm].
    pub mean: T,
    /// What is recorded.
    pub engine_speed: T,
    pub rack: T,
    pub brake: T,
    pub shaft: T,
    pub gauge: T,
    pub rates: State<T>,
}

impl<T: Scalar> DriveTrain<T> {
    /// Torque lost at the shaft [Nm].
    #[inline(always)]
    fn drag_torque(&self, shaft_speed: T) -> T {
        if self.drag.is_zero() { self.drag } else { self.drag * shaft_speed.power(self.drag_exponent) }
    }

    /// Torque limit of the envelope at an engine speed [Nm].
    #[inline(always)]
    fn limit(&self, limit: &mut impl Slope, engine_speed: T) -> T {
        let torque = limit.torque(engine_speed.value());
        engine_speed.function(torque, limit.slope()) * self.limit_factor
    }

    /// The limits that the governor's command meets at a state.
    #[inline(always)]
    #[must_use]
    pub fn ceiling(&self, limit: &mut impl Slope, engine_speed: T, charge: T) -> Ceiling<T> {
        let rack = smaller(charge + self.smoke_margin, self.governor.maximum_rack);
        let torque = if self.governor.anti_windup {
            let Engine { rack_gain, speed_gain, offset, .. } = self.engine;
            (self.limit(limit, engine_speed) - speed_gain * engine_speed - offset) / rack_gain
        } else {
            charge.constant(f64::INFINITY)
        };
        Ceiling { rack, torque }
    }

    /// The governor's command, and how its memory changes, at an instant.
    #[inline(always)]
    #[must_use]
    pub fn command(&self, limit: &mut impl Slope, set_speed: T, held: T, state: &State<T>) -> Command<T> {
        if self.governor.timing != Timing::Continuous {
            let still = held.constant(0.0);
            return Command { rack: held, error_rate: still, filter_rate: still };
        }
        let speed = state.engine_side * self.gearbox.ratio;
        let ceiling = self.ceiling(limit, speed, state.charge);
        self.governor.command(set_speed, speed, state.error, state.filtered, &ceiling)
    }

    /// From the set point to the torque that the engine is to give.
    #[inline(always)]
    #[must_use]
    pub fn fuel_path(
        &self,
        limit: &mut impl Slope,
        memory: &Memory<T>,
        at: &Instant<T>,
        state: &State<T>,
    ) -> FuelPath<T> {
        let engine_speed = state.engine_side * self.gearbox.ratio;
        let command = self.command(limit, at.set_speed, memory.held, state);
        let fuel = at.arriving.unwrap_or(command.rack);
        let ordered = memory.rack.reached(fuel, at.elapsed);
        let (rack, rack_rate) = if self.actuator.lag.value() > 0.0 {
            (state.rack, (ordered - state.rack) / self.actuator.lag)
        } else {
            (ordered, ordered.constant(0.0))
        };
        let demand = limited(
            self.engine.demand(rack, engine_speed),
            self.engine.minimum_torque,
            self.limit(limit, engine_speed),
        );
        FuelPath { command, fuel, rack, rack_rate, demand }
    }

    /// Everything at an instant.
    #[inline(always)]
    #[must_use]
    pub fn flow(
        &self,
        limit: &mut impl Slope,
        memory: &Memory<T>,
        at: &Instant<T>,
        state: &State<T>,
    ) -> Flow<T> {
        let engine_speed = state.engine_side * self.gearbox.ratio;
        let FuelPath { command, rack, rack_rate, demand, .. } = self.fuel_path(limit, memory, at, state);
        let charge_rate = if self.smoke_margin.value().is_finite() {
            (rack - state.charge) / self.turbocharger_lag
        } else {
            rack.constant(0.0)
        };
        let mean = memory.torque.reached(demand, at.elapsed);
        let brake = if memory.firing.acts() { memory.firing.torque(state.crank) } else { mean };
        let shaft = self.gearbox.shaft_torque(brake) - self.drag_torque(state.engine_side);
        let [load, thrust] = self.propeller.torque_and_thrust(state.propeller, state.turn, state.ship);
        let slip = state.engine_side - state.propeller;
        let answer = self.shaft.answer(shaft, load, state.twist, slip);
        Flow {
            command: command.rack,
            mean,
            engine_speed,
            rack,
            brake,
            shaft,
            gauge: answer.gauge,
            rates: State {
                engine_side: answer.engine_side,
                propeller: answer.propeller_side,
                twist: slip,
                crank: engine_speed,
                turn: state.propeller,
                rack: rack_rate,
                charge: charge_rate,
                error: command.error_rate,
                filtered: command.filter_rate,
                ship: self.ship.acceleration(thrust, state.ship),
            },
        }
    }

    /// The state from which a record starts: rack and twist have their steady values.
    #[must_use]
    pub fn start(&self) -> (State<T>, Memory<T>) {
        let speed = self.initial_speed;
        let engine_speed = speed * self.gearbox.ratio;
        let Governor { base_rack, proportional, integral, .. } = self.governor;
        let rack =
            base_rack + proportional * (self.set_point_before - engine_speed) + integral * self.initial_error;
        let torque = self.engine.demand(rack, engine_speed);
        let [load, _] = self.propeller.mean_torque_and_thrust(speed, self.initial_ship_speed);
        let state = State {
            engine_side: speed,
            propeller: speed,
            twist: self.shaft.twist(load),
            crank: self.crank_angle,
            turn: speed.constant(0.0),
            rack,
            charge: rack,
            error: self.initial_error,
            filtered: engine_speed,
            ship: self.initial_ship_speed,
        };
        let memory = Memory {
            rack: Ramp::new(self.actuator.rate, rack),
            torque: Ramp::new(self.torque_rate, torque),
            firing: Firing::new(self.firing_interval, self.firing_width, &self.strength, torque),
            held: rack,
        };
        (state, memory)
    }
}

/// The signals at an instant, to be computed in one place.
pub struct FlowAt<'a, L, T> {
    pub train: &'a DriveTrain<T>,
    pub limit: &'a mut L,
    pub memory: &'a Memory<T>,
    pub at: &'a Instant<T>,
    pub state: &'a State<T>,
}

impl<L: Slope, T: Scalar> WithSimd for FlowAt<'_, L, T> {
    type Output = Flow<T>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> Flow<T> {
        self.train.flow(self.limit, self.memory, self.at, self.state)
    }
}

/// Number of signals that [`flow_at`] gives behind the rates: command, `M_b`, `M_g`, `M_s`, `X_f`.
pub const FLOW: usize = 5;

/// Rates of the state and signals of a drive train at a state, a set point [rev/s] at the governor and a rack command
/// [mm] at the actuator: what a linearisation takes its differences of.
#[must_use]
pub fn flow_at(
    train: &DriveTrain,
    envelope: &Envelope,
    state: &State,
    set_speed: f64,
    fuel: f64,
) -> [f64; STATES + FLOW] {
    let (_, memory) = train.start();
    let at = Instant { elapsed: 0.0, set_speed, arriving: Some(fuel) };
    let flow = match envelope {
        Envelope::Constant(limit) => train.flow(&mut { *limit }, &memory, &at, state),
        Envelope::Table(table) => train.flow(&mut table.cursor(), &memory, &at, state),
    };
    let mut found = [0.0; STATES + FLOW];
    found[..STATES].copy_from_slice(&flow.rates.to_array());
    found[STATES..].copy_from_slice(&[flow.command, flow.brake, flow.gauge, flow.shaft, flow.rack]);
    found
}
