//! Steps of the classical Runge-Kutta method through a record, with numbers that carry their derivatives.

use pulp::{Simd, WithSimd};

use crate::drive_train::{DriveTrain, Ramp, Run};
use crate::error::Result;
use crate::instruction_set::arch;
use crate::integrate::Hold;
use crate::plant::{Envelope, Governor, Propeller, Slope, State, limited};
use crate::scalar::{Scalar, Tangent};
use crate::stop::Stop;
use crate::subnormal::CUT_EVERY;

use super::output::{Consume, Output, require_finite};
use super::parameters::Subject;

/// As [`super::pass::march`], where nothing acts but rate limits and a late set point.
pub fn through_plant<const N: usize>(
    subject: &Subject,
    run: &Run<'_>,
    outputs: &[Output],
    block: usize,
    stop: &Stop,
    consume: &mut Consume<'_, N>,
) -> Result<()> {
    match &subject.envelope {
        Envelope::Constant(limit) => {
            arch().dispatch(Through { subject, limit: *limit, run, outputs, block, stop, consume })
        }
        Envelope::Table(table) => {
            let limit = table.cursor();
            arch().dispatch(Through { subject, limit, run, outputs, block, stop, consume })
        }
    }
}

struct Through<'a, 'c, L, const N: usize> {
    subject: &'a Subject,
    limit: L,
    run: &'a Run<'a>,
    outputs: &'a [Output],
    block: usize,
    stop: &'a Stop,
    consume: &'a mut Consume<'c, N>,
}

impl<L: Slope, const N: usize> WithSimd for Through<'_, '_, L, N> {
    type Output = Result<()>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Result<()> {
        let Self { subject, limit, run, outputs, block, stop, consume } = self;
        let mut march = March::new(subject.drive_train::<S, N>(simd), limit, run);
        let samples = run.set_speed.len();
        let mut rows = vec![Tangent { value: 0.0, slopes: [0.0; N] }; block * outputs.len()];
        for from in (0..samples).step_by(block) {
            stop.check()?;
            let rows = &mut rows[..block.min(samples - from) * outputs.len()];
            for (k, row) in rows.chunks_exact_mut(outputs.len()).enumerate() {
                let flow = march.show(from + k);
                for (number, output) in row.iter_mut().zip(outputs) {
                    *number = march.output(*output, &flow).tangent();
                }
                march.pass(from + k, flow);
                if k % CUT_EVERY == 0 {
                    march.state.speed = march.state.speed.cut();
                    march.state.error = march.state.error.cut();
                }
            }
            require_finite(from, rows, outputs, run.dt)?;
            consume(from, rows)?;
        }
        Ok(())
    }
}

/// Least share of a sample interval by which a dead time exceeds whole ones: a piece without length would stand on the
/// kink of every rate limit, where a derivative by its length means nothing.
const LEAST_PART: f64 = 1e-9;

/// Dead times of the set point are at most so long [sample intervals], later than any record.
const LATEST: f64 = (1_u64 << 50) as f64;

/// A stretch over which the set point is straight.
#[derive(Debug, Clone, Copy)]
struct Piece<T> {
    /// At its start [rev/s].
    set: T,
    /// [rev/s2].
    slope: f64,
    /// [s].
    duration: T,
}

/// The set point behind its dead time: a sample interval is one piece, or two where a delayed sample arrives within.
#[derive(Debug, Clone, Copy)]
struct Feed<'a, T> {
    samples: &'a [f64],
    /// What it was before the record [rev/s].
    before: f64,
    dt: f64,
    hold: Hold,
    /// Whole sample intervals of the dead time, and what is left of it; None without one.
    late: Option<(usize, T)>,
}

impl<'a, T: Scalar> Feed<'a, T> {
    fn new(train: &DriveTrain<T>, run: &Run<'a>) -> Self {
        let Run { set_speed: samples, dt, hold, .. } = *run;
        let intervals = (train.set_dead_time.value() / dt).floor().min(LATEST);
        let rest = train.set_dead_time + -train.set_dead_time.value().min(intervals * dt);
        let rest = rest + (dt - rest.value()).min(0.0);
        let rest = rest + (LEAST_PART * dt - rest.value()).max(0.0);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // Not negative; saturates.
        let late = (intervals as usize, rest);
        let before = train.set_point_before.value();
        Self {
            samples,
            before,
            dt,
            hold,
            late: if train.set_dead_time.is_zero() { None } else { Some(late) },
        }
    }

    /// From a sample so many intervals before sample `k` on: its value and the slope to the next; ends of the record hold.
    #[inline(always)]
    fn from(&self, k: usize, intervals: usize) -> (f64, f64) {
        let Some(piece) = k.checked_sub(intervals) else { return (self.before, 0.0) };
        let last = self.samples.len() - 1;
        let (from, to) = (self.samples[piece.min(last)], self.samples[(piece + 1).min(last)]);
        (from, if self.hold == Hold::First { (to - from) / self.dt } else { 0.0 })
    }

    /// The pieces between sample `k` and the next, the last of them beginning where a sample arrives.
    #[inline(always)]
    fn pieces(&self, k: usize, like: T) -> (Option<Piece<T>>, Piece<T>) {
        let whole = self.late.map_or(0, |(whole, _)| whole);
        let (arriving, slope) = self.from(k, whole);
        let main = Piece { set: like.constant(arriving), slope, duration: like.constant(self.dt) };
        let Some((_, part)) = self.late else { return (None, main) };
        let (past, slope) = self.from(k, whole.saturating_add(1));
        let left = main.duration - part;
        let lead = Piece { set: left * slope + past, slope, duration: part };
        (Some(lead), Piece { duration: left, ..main })
    }
}

/// All signals at an instant.
#[derive(Debug, Clone, Copy)]
struct Flow<T> {
    /// The rack before its rate is limited [mm], and behind.
    ordered: T,
    rack: T,
    /// The brake torque before its rate is limited [Nm], and behind.
    demand: T,
    brake: T,
    /// Rates of the state: [rev/s2] and [rev/s].
    acceleration: T,
    miss: T,
}

/// A simulation under way. Its state is the engine speed [rev/s] and the integrated error [rev].
struct March<'a, T, L> {
    train: DriveTrain<T>,
    governor: Governor<T>,
    propeller: Propeller<T>,
    /// Whether the propeller's exponent is 2 in all directions.
    square: bool,
    /// What a brake torque of 1 Nm adds to the rate of the engine speed, and what the propeller takes from it where
    /// that is 1 rev/s: gearbox, shaft and propeller folded, since they are linear in torques.
    drive: T,
    drag: T,
    shaft_per_engine_speed: T,
    limit: L,
    run: &'a Run<'a>,
    feed: Feed<'a, T>,
    state: State<T>,
    /// Of the rack and of the brake torque.
    ramps: [Ramp<T>; 2],
}

impl<'a, T: Scalar, L: Slope> March<'a, T, L> {
    fn new(train: DriveTrain<T>, limit: L, run: &'a Run<'a>) -> Self {
        let feed = Feed::new(&train, run);
        let DriveTrain { engine, gearbox, shaft, actuator, .. } = &train;
        let crate::drive_train::Governor { base_rack, proportional, integral, .. } = train.governor;
        let governor = Governor { base_rack, proportional, integral };
        let crate::drive_train::Propeller { coefficient, exponent, .. } = train.propeller;
        let propeller = Propeller { coefficient, exponent };
        let square = exponent == exponent.constant(2.0);
        let state = State { speed: train.initial_speed * gearbox.ratio, error: train.initial_error };
        let rack = governor.rack(train.set_point_before - state.speed, state.error);
        let ramps =
            [Ramp::new(actuator.rate, rack), Ramp::new(train.torque_rate, engine.demand(rack, state.speed))];
        let (zero, one) = (state.speed.constant(0.0), state.speed.constant(1.0));
        let shaft_per_engine_speed = one / gearbox.ratio;
        let engine_speed_from =
            |drive, load| shaft.answer(drive, load, zero, zero).engine_side * gearbox.ratio;
        let drive = engine_speed_from(gearbox.shaft_torque(one), zero);
        let drag = engine_speed_from(zero, propeller.torque(shaft_per_engine_speed));
        Self {
            train,
            governor,
            propeller,
            square,
            drive,
            drag,
            shaft_per_engine_speed,
            limit,
            run,
            feed,
            state,
            ramps,
        }
    }

    /// All signals at sample `k`, the next one.
    #[inline(always)]
    fn show(&mut self, k: usize) -> Flow<T> {
        let (lead, main) = self.feed.pieces(k, self.state.speed);
        // A sample that arrives now, as a jump, counts already.
        let least = LEAST_PART * self.feed.dt;
        let shown = lead.filter(|lead| self.feed.hold == Hold::First || lead.duration.value() > least);
        let set = match shown {
            Some(lead) => lead.set,
            None => main.set,
        };
        self.flow(set, set.constant(0.0), self.state)
    }

    /// Advance from sample `k`, whose signals are `flow`, to the next.
    #[inline(always)]
    fn pass(&mut self, k: usize, flow: Flow<T>) {
        let (lead, main) = self.feed.pieces(k, self.state.speed);
        if let Some(lead) = lead {
            self.advance(lead, None);
            self.advance(main, None);
        } else {
            self.advance(main, Some(flow));
        }
    }

    #[inline(always)]
    fn output(&self, output: Output, flow: &Flow<T>) -> T {
        match output {
            Output::EngineSpeed => self.state.speed,
            Output::ShaftSpeed => self.state.speed * self.shaft_per_engine_speed,
            Output::BrakeTorque => flow.brake,
            Output::GaugeTorque => {
                let DriveTrain { gearbox, shaft, .. } = &self.train;
                let load = self.propeller.torque(self.state.speed * self.shaft_per_engine_speed);
                let zero = load.constant(0.0);
                shaft.answer(gearbox.shaft_torque(flow.brake), load, zero, zero).gauge
            }
            Output::Rack => flow.rack,
            Output::Error => self.state.error,
        }
    }

    /// Advance through a piece in equal steps; `begin` is the flow at the start of the piece, where it is known.
    #[inline(always)]
    fn advance(&mut self, piece: Piece<T>, mut begin: Option<Flow<T>>) {
        let step = piece.duration * (1.0 / self.run.substeps as f64);
        let unit = step * 0.5;
        for substep in 0..self.run.substeps {
            let set = piece.set + step * (piece.slope * substep as f64);
            let state = self.state;
            let first = match begin.take() {
                Some(flow) => flow,
                None => self.flow(set, set.constant(0.0), state),
            };
            // As in `integrate`, with the flow in one place: in a closure that is called thrice it is not inlined, and what
            // is not inlined is not compiled for the machine's vectors.
            let mut change = State { speed: first.acceleration * unit, error: first.miss * unit };
            let mut sum = change;
            for (part, weight) in [(0.5, 2.0), (0.5, 2.0), (1.0, 1.0)] {
                let elapsed = step * part;
                let flow = self.flow(set + elapsed * piece.slope, elapsed, state + change * (2.0 * part));
                change = State { speed: flow.acceleration * unit, error: flow.miss * unit };
                sum = sum + change * weight;
            }
            self.state = state + sum * (1.0 / 3.0);
            if self.ramps[0].acts() || self.ramps[1].acts() {
                let end = self.flow(set + step * piece.slope, step, self.state);
                self.ramps[0].advance(end.ordered, step);
                self.ramps[1].advance(end.demand, step);
            }
        }
    }

    /// Everything at a set point and a state, so long [s] after a step began.
    #[inline(always)]
    fn flow(&mut self, set: T, elapsed: T, state: State<T>) -> Flow<T> {
        let DriveTrain { engine, limit_factor, .. } = &self.train;
        let (miss, speed) = (set - state.speed, state.speed);
        let ordered = self.governor.rack(miss, state.error);
        let rack = self.ramps[0].reached(ordered, elapsed);
        let demand = engine.demand(rack, speed);
        let limit = self.limit.torque(speed.value());
        let limit = speed.function(limit, self.limit.slope()) * *limit_factor;
        let demand = limited(demand, engine.minimum_torque, limit);
        let brake = self.ramps[1].reached(demand, elapsed);
        // Mostly a square: a branch that is always foreseen, and no power function.
        let taken = if self.square { speed.square() } else { speed.power(self.propeller.exponent) };
        let acceleration = brake * self.drive + taken * self.drag;
        Flow { ordered, rack, demand, brake, acceleration, miss }
    }
}
