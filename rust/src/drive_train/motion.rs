//! The equations of motion of the drive train between two events.

use crate::plant::{Engine, Envelope, Gearbox, Library, Limit, Power, limited};

use super::firing::Firing;
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
    /// Of the set point's path [s].
    pub set_dead_time: f64,
    pub actuator: Actuator,
    pub engine: Engine,
    /// By how much the rack may exceed what the charge air is good for [mm].
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

/// What the drive train remembers from one step to the next.
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

/// What the governor and the fuel's way make of an instant.
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
    #[must_use]
    pub fn drag_torque(&self, shaft_speed: f64) -> f64 {
        if self.drag == 0.0 { 0.0 } else { self.drag * Library::of(shaft_speed, self.drag_exponent) }
    }

    /// What holds the governor's command at a state.
    #[inline(always)]
    #[must_use]
    pub fn ceiling(&self, limit: &mut impl Limit, engine_speed: f64, charge: f64) -> Ceiling {
        let rack = (charge + self.smoke_margin).min(self.governor.maximum_rack);
        let torque = if self.governor.anti_windup {
            let Engine { rack_gain, speed_gain, offset, .. } = self.engine;
            (limit.torque(engine_speed) - speed_gain * engine_speed - offset) / rack_gain
        } else {
            f64::INFINITY
        };
        Ceiling { rack, torque }
    }

    /// The governor's command, and how its memory changes, at an instant.
    #[inline(always)]
    #[must_use]
    pub fn command(&self, limit: &mut impl Limit, set_speed: f64, held: f64, state: &State) -> Command {
        if self.governor.timing != Timing::Continuous {
            return Command { rack: held, error_rate: 0.0, filter_rate: 0.0 };
        }
        let speed = self.gearbox.ratio * state.engine_side;
        let ceiling = self.ceiling(limit, speed, state.charge);
        self.governor.command(set_speed, speed, state.error, state.filtered, &ceiling)
    }

    /// From the set point to the torque that the engine is to give.
    #[inline(always)]
    #[must_use]
    pub fn fuel_path(
        &self,
        limit: &mut impl Limit,
        memory: &Memory,
        at: &Instant,
        state: &State,
    ) -> FuelPath {
        let engine_speed = self.gearbox.ratio * state.engine_side;
        let command = self.command(limit, at.set_speed, memory.held, state);
        let fuel = at.arriving.unwrap_or(command.rack);
        let ordered = memory.rack.reached(fuel, at.elapsed);
        let (rack, rack_rate) = if self.actuator.lag > 0.0 {
            (state.rack, (ordered - state.rack) / self.actuator.lag)
        } else {
            (ordered, 0.0)
        };
        let Engine { rack_gain, speed_gain, offset, minimum_torque } = self.engine;
        let demand = limited(
            rack * rack_gain + engine_speed * speed_gain + offset,
            minimum_torque,
            limit.torque(engine_speed),
        );
        FuelPath { command, fuel, rack, rack_rate, demand }
    }

    /// Everything at an instant.
    #[inline(always)]
    #[must_use]
    pub fn flow(&self, limit: &mut impl Limit, memory: &Memory, at: &Instant, state: &State) -> Flow {
        let engine_speed = self.gearbox.ratio * state.engine_side;
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

    /// The state from which a record starts: the rack and the twist as if all had stood so for long.
    #[must_use]
    pub fn start(&self) -> (State, Memory) {
        let speed = self.initial_speed;
        let engine_speed = self.gearbox.ratio * speed;
        let Governor { base_rack, proportional, integral, .. } = self.governor;
        let rack =
            base_rack + proportional * (self.set_point_before - engine_speed) + integral * self.initial_error;
        let Engine { rack_gain, speed_gain, offset, .. } = self.engine;
        let torque = rack * rack_gain + engine_speed * speed_gain + offset;
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
    let flow = match envelope {
        Envelope::Constant(limit) => train.flow(&mut { *limit }, &memory, &at, state),
        Envelope::Table(table) => train.flow(&mut table.cursor(), &memory, &at, state),
    };
    let mut found = [0.0; STATES + FLOW];
    found[..STATES].copy_from_slice(&flow.rates.to_array());
    found[STATES..].copy_from_slice(&[flow.command, flow.brake, flow.gauge, flow.shaft, flow.rack]);
    found
}
