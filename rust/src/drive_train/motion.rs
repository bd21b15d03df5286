//! The equations of motion of the drive train between two events.

use crate::power::power;
use crate::stepper::Envelope;

use super::engine::{Engine, limited};
use super::firing::Firing;
use super::gearbox::Gearbox;
use super::governor::{Ceiling, Command, Timing};
use super::ramp::Ramp;
use super::shaft::Shaft;
use super::ship::Ship;
use super::{Governor, Propeller, STATES, State};

/// Path of the command to the fuel rack.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Actuator {
    /// [s].
    pub dead_time: f64,
    /// Time constant [s].
    pub lag: f64,
    /// Of the rack [mm/s].
    pub rate: f64,
}

/// All components and where they start.
#[derive(Debug, Clone)]
#[allow(missing_docs)]
pub struct DriveTrain {
    pub governor: Governor,
    /// Dead time of the set point [s].
    pub set_dead_time: f64,
    pub actuator: Actuator,
    pub engine: Engine,
    /// Fuel that the smoke limiter allows beyond what the charge air can burn [mm of rack].
    pub smoke_margin: f64,
    /// Time constant of the charge air behind the rack [s].
    pub turbocharger_lag: f64,
    /// Of the brake torque [Nm/s].
    pub torque_rate: f64,
    /// [rev of the engine], zero for a torque without pulses.
    pub firing_interval: f64,
    pub firing_width: f64,
    pub strength: Vec<f64>,
    pub gearbox: Gearbox,
    /// Torque lost at the shaft [Nm/(rev/s)^`drag_exponent`], beside the gearbox's efficiency.
    pub drag: f64,
    pub drag_exponent: f64,
    pub shaft: Shaft,
    pub propeller: Propeller,
    pub ship: Ship,
    /// Shaft speed [rev/s].
    pub initial_speed: f64,
    /// [rev].
    pub initial_error: f64,
    /// [m/s].
    pub initial_ship_speed: f64,
    /// Set point before the record [rev/s].
    pub set_point_before: f64,
    /// At the first sample [rev].
    pub crank_angle: f64,
}

/// The drive train's memory between steps.
#[derive(Debug, Clone)]
pub struct Memory {
    pub rack: Ramp,
    pub torque: Ramp,
    pub firing: Firing,
    /// Command that a sampling governor holds [mm].
    pub held: f64,
}

/// What acts on the drive train within a step.
#[derive(Debug, Clone, Copy)]
pub struct Instant {
    /// Time since the step began [s].
    pub elapsed: f64,
    /// Set point at the governor [rev/s]; of no meaning where that computes at times of its own.
    pub set_speed: f64,
    /// Command that comes out of the actuator's dead time [mm]; None: there is none.
    pub arriving: Option<f64>,
}

/// Signals of the governor and of the fuel path at an instant.
#[derive(Debug, Clone, Copy)]
pub struct FuelPath {
    /// Of the governor.
    pub command: Command,
    /// Behind the dead time, before its rate is limited [mm].
    pub fuel: f64,
    /// [mm].
    pub rack: f64,
    /// [mm/s].
    pub rack_rate: f64,
    /// Mean brake torque before its rate is limited [Nm].
    pub demand: f64,
}

/// All signals at an instant, and the rates of the state.
#[derive(Debug, Clone, Copy)]
pub struct Flow {
    /// Of the governor [mm].
    pub command: f64,
    /// Mean brake torque [Nm].
    pub mean: f64,
    /// What is recorded.
    pub engine_speed: f64,
    pub rack: f64,
    pub brake: f64,
    pub shaft: f64,
    pub gauge: f64,
    pub rates: State,
}

impl DriveTrain {
    /// Torque lost at the shaft [Nm].
    #[inline(always)]
    fn drag_torque(&self, shaft_speed: f64) -> f64 {
        if self.drag == 0.0 { 0.0 } else { self.drag * power(shaft_speed, self.drag_exponent) }
    }

    /// The limits that the governor's command meets at a state.
    #[inline(always)]
    #[must_use]
    pub fn ceiling(&self, limit: &Envelope, engine_speed: f64, charge: f64) -> Ceiling {
        let rack = self.governor.maximum_rack.min(charge + self.smoke_margin);
        let torque = if self.governor.anti_windup {
            let Engine { rack_gain, speed_gain, offset, .. } = self.engine;
            (limit.at(engine_speed)[0] - speed_gain * engine_speed - offset) / rack_gain
        } else {
            f64::INFINITY
        };
        Ceiling { rack, torque }
    }

    /// The governor's command, and how its memory changes, at an instant.
    #[inline(always)]
    #[must_use]
    pub fn command(&self, limit: &Envelope, set_speed: f64, held: f64, state: &State) -> Command {
        if self.governor.timing != Timing::Continuous {
            return Command { rack: held, error_rate: 0.0, filter_rate: 0.0 };
        }
        let speed = state.engine_side * self.gearbox.ratio;
        let ceiling = self.ceiling(limit, speed, state.charge);
        self.governor.command(set_speed, speed, state.error, state.filtered, &ceiling)
    }

    /// From the set point to the torque that the engine is to give.
    #[inline(always)]
    #[must_use]
    pub fn fuel_path(&self, limit: &Envelope, memory: &Memory, at: &Instant, state: &State) -> FuelPath {
        let engine_speed = state.engine_side * self.gearbox.ratio;
        let command = self.command(limit, at.set_speed, memory.held, state);
        let fuel = at.arriving.unwrap_or(command.rack);
        let ordered = memory.rack.reached(fuel, at.elapsed);
        let (rack, rack_rate) = if self.actuator.lag > 0.0 {
            (state.rack, (ordered - state.rack) / self.actuator.lag)
        } else {
            (ordered, 0.0)
        };
        let demand = limited(
            self.engine.demand(rack, engine_speed),
            self.engine.minimum_torque,
            limit.at(engine_speed)[0],
        );
        FuelPath { command, fuel, rack, rack_rate, demand }
    }

    /// Everything at an instant.
    #[inline(always)]
    #[must_use]
    pub fn flow(&self, limit: &Envelope, memory: &Memory, at: &Instant, state: &State) -> Flow {
        let engine_speed = state.engine_side * self.gearbox.ratio;
        let FuelPath { command, rack, rack_rate, demand, .. } = self.fuel_path(limit, memory, at, state);
        let charge_rate =
            if self.smoke_margin.is_finite() { (rack - state.charge) / self.turbocharger_lag } else { 0.0 };
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
    pub fn start(&self) -> (State, Memory) {
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
            turn: 0.0,
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
    let flow = train.flow(envelope, &memory, &at, state);
    let mut found = [0.0; STATES + FLOW];
    found[..STATES].copy_from_slice(&flow.rates.to_array());
    found[STATES..].copy_from_slice(&[flow.command, flow.brake, flow.gauge, flow.shaft, flow.rack]);
    found
}
