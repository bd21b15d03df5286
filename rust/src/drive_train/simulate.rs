//! Steps of the classical Runge-Kutta method, cut at what breaks the signals: delayed samples and the governor's own.

use crate::error::{Error, Result, require};
use crate::integrate::Hold;
use crate::plant::{Envelope, Limit};
use crate::stop::{CHECK_EVERY, Stop};

use super::delay::Delay;
use super::governor::{self, Timing};
use super::motion::{Flow, Instant, Memory};
use super::set_point::SetPoint;
use super::{DriveTrain, State};

/// Rows of a result: `n_e`, `n_s` [rev/s], `M_b`, `M_g`, `M_s` [Nm], `X_f` [mm], `E_n` [rev], ship speed [m/s].
pub const ROWS: usize = 8;

/// What is closer than this share of a step is at one time.
const SAME: f64 = 1e-8;
/// By this share of a step a time is moved to say which side of a jump is meant.
const NUDGE: f64 = 1e-6;

/// What to simulate.
#[derive(Debug, Clone, Copy)]
pub struct Run<'a> {
    /// Set point of the engine speed [rev/s].
    pub set_speed: &'a [f64],
    /// Sample time [s].
    pub dt: f64,
    /// Steps a sample.
    pub substeps: usize,
    /// Of the set point between samples.
    pub hold: Hold,
}

impl Run<'_> {
    /// Refuse what can't be simulated.
    ///
    /// # Errors
    /// Where the sample time is not positive, there are no steps or no samples, or a set point is not finite.
    pub fn check(&self) -> Result<()> {
        let Self { set_speed, dt, substeps, .. } = *self;
        require(dt.is_finite() && dt > 0.0, || format!("dt is {dt}, expected a positive sample time [s]"))?;
        require(substeps > 0, || "substeps is 0, expected at least 1".to_owned())?;
        require(!set_speed.is_empty(), || "n_set has no samples, expected at least 1".to_owned())?;
        match set_speed.iter().position(|value| !value.is_finite()) {
            None => Ok(()),
            Some(bad) => Err(Error::Invalid(format!(
                "n_set is {} at sample {bad}, expected finite speeds [rev/s]",
                set_speed[bad]
            ))),
        }
    }
}

/// Simulate a run into [`ROWS`] rows of as many columns as the set point has samples.
///
/// # Errors
/// [`Error::Invalid`] for what can't be simulated, [`Error::Diverged`] where a result is not finite,
/// [`Error::Stopped`] on request.
pub fn simulate(
    train: &DriveTrain,
    envelope: &Envelope,
    run: &Run<'_>,
    output: &mut [f64],
    stop: &Stop,
) -> Result<()> {
    let Run { set_speed, dt, substeps, .. } = *run;
    run.check()?;
    let length = ROWS * set_speed.len();
    require(output.len() == length, || format!("output has {} values, expected {length}", output.len()))?;
    let step = dt / substeps as f64;
    let dead_time = train.actuator.dead_time;
    require(dead_time == 0.0 || dead_time >= step * (1.0 - SAME), || {
        format!(
            "parameters: fuel_dead_time is {dead_time} s, expected 0 or at least a step, {step} s; use more substeps"
        )
    })?;
    if let Timing::Every(period) = train.governor.timing {
        require(period >= step * (1.0 - SAME), || {
            format!(
                "parameters: governor_period is {period} s, expected 0 or at least a step, {step} s; use more substeps"
            )
        })?;
    }
    match envelope {
        Envelope::Constant(limit) => March::new(train, *limit, run).through(output, stop),
        Envelope::Table(table) => March::new(train, table.cursor(), run).through(output, stop),
    }
}

/// A simulation under way.
struct March<'a, L> {
    train: &'a DriveTrain,
    limit: L,
    run: &'a Run<'a>,
    set_point: SetPoint<'a>,
    step: f64,
    state: State,
    memory: Memory,
    delay: Delay,
    governor: governor::Memory,
    /// Times of the governor's last and next sample [s].
    last_sample: f64,
    next_sample: f64,
    samples_taken: u64,
    /// Whether the end of each step must be looked at.
    remembers: bool,
}

impl<'a, L: Limit> March<'a, L> {
    fn new(train: &'a DriveTrain, limit: L, run: &'a Run<'a>) -> Self {
        let (state, memory) = train.start();
        let step = run.dt / run.substeps as f64;
        let set_point = SetPoint {
            samples: run.set_speed,
            before: train.set_point_before,
            dt: run.dt,
            dead_time: train.set_dead_time,
            hold: run.hold,
        };
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // Saturates; a capacity only.
        let steps = (train.actuator.dead_time / step).min(1e6) as usize;
        let mut delay = Delay::new(train.actuator.dead_time, memory.held, 2 * steps);
        delay.push_break(0.0);
        Self {
            train,
            limit,
            run,
            set_point,
            step,
            governor: governor::Memory {
                integrated: state.error,
                filtered: state.filtered,
                miss: train.set_point_before - train.gearbox.ratio * state.engine_side,
            },
            last_sample: 0.0,
            next_sample: if matches!(train.governor.timing, Timing::Every(_)) { 0.0 } else { f64::INFINITY },
            samples_taken: 0,
            remembers: delay.acts() || memory.rack.acts() || memory.torque.acts(),
            state,
            memory,
            delay,
        }
    }

    fn through(mut self, output: &mut [f64], stop: &Stop) -> Result<()> {
        let Run { dt, substeps, set_speed, .. } = *self.run;
        let samples = set_speed.len();
        let look_every = (CHECK_EVERY / substeps).max(1);
        for sample in 0..samples {
            if sample % look_every == 0 {
                stop.check()?;
            }
            let mut time = sample as f64 * dt;
            let mut first = Some(self.begin(time));
            if let Some(flow) = &first {
                self.record(flow, sample, output, samples)?;
            }
            if sample + 1 == samples {
                break;
            }
            for substep in 1..=substeps {
                let border = (sample as f64 + substep as f64 / substeps as f64) * dt;
                loop {
                    let begin = first.take().unwrap_or_else(|| self.begin(time));
                    let end = self.next_cut(time, &begin).min(border);
                    let end = if border - end < SAME * self.step { border } else { end };
                    self.advance(time, end - time, &begin);
                    time = end;
                    if time >= border {
                        break;
                    }
                }
            }
        }
        Ok(())
    }

    /// The next time at which a step must end.
    fn next_cut(&mut self, time: f64, begin: &Flow) -> f64 {
        let soon = time + SAME * self.step;
        let sample = if self.next_sample > soon { self.next_sample } else { f64::INFINITY };
        let cut = sample.min(self.set_point.next_break(soon)).min(self.delay.next_break(soon));
        // Fired at the end of whatever step passes the angle, cylinders would beat with the steps.
        let wait = self.memory.firing.left(self.state.crank) / begin.rates.crank;
        if wait > 0.0 && wait < 2.0 * self.step {
            let acceleration = self.train.gearbox.ratio * begin.rates.engine_side;
            let wait = wait / (1.0 + 0.5 * acceleration * wait / begin.rates.crank);
            if time + wait > soon { cut.min(time + wait) } else { cut }
        } else {
            cut
        }
    }

    /// The signals at a time from which a step starts, once what is due there is done.
    fn begin(&mut self, time: f64) -> Flow {
        if self.delay.acts() {
            self.delay.forget(time);
        }
        let fires = self.memory.firing.due(self.state.crank);
        match self.train.governor.timing {
            Timing::Every(period) => {
                if time >= self.next_sample - SAME * self.step {
                    self.samples_taken += 1;
                    self.next_sample = self.samples_taken as f64 * period;
                    self.sample(time);
                }
            }
            Timing::AtFiring if fires => self.sample(time),
            Timing::Continuous | Timing::AtFiring => {}
        }
        let nudge = NUDGE * self.step;
        let mut at = self.instant(time, 0.0, nudge);
        let mut flow = self.train.flow(&mut self.limit, &self.memory, &at, &self.state);
        if fires {
            // No step is so long that a cylinder fires twice in it, unless the speed has left all bounds.
            for _ in 0..self.train.strength.len() {
                if self.memory.firing.due(self.state.crank) {
                    self.memory.firing.fire(flow.mean);
                }
            }
            at = self.instant(time, 0.0, nudge);
            flow = self.train.flow(&mut self.limit, &self.memory, &at, &self.state);
        }
        if self.delay.acts() {
            self.delay.push(time, flow.command);
        }
        flow
    }

    /// Let the governor compute.
    fn sample(&mut self, time: f64) {
        let speed = self.train.gearbox.ratio * self.state.engine_side;
        let ceiling = self.train.ceiling(&mut self.limit, speed, self.state.charge);
        let set_speed = self.set_point.at(time, time + NUDGE * self.step);
        let elapsed = time - self.last_sample;
        self.memory.held =
            self.train.governor.sample(set_speed, speed, &mut self.governor, elapsed, &ceiling);
        self.state.error = self.governor.integrated;
        self.last_sample = time;
        if self.delay.acts() {
            self.delay.push_break(time);
        }
    }

    fn instant(&self, begin: f64, elapsed: f64, nudge: f64) -> Instant {
        let time = begin + elapsed;
        Instant {
            elapsed,
            set_speed: if self.train.governor.timing == Timing::Continuous {
                self.set_point.at(time, time + nudge)
            } else {
                f64::NAN
            },
            arriving: self.delay.acts().then(|| self.delay.at(time, nudge)),
        }
    }

    /// A step of the classical Runge-Kutta method that starts with `begin`.
    fn advance(&mut self, time: f64, step: f64, begin: &Flow) {
        let middle = self.instant(time, 0.5 * step, 0.0);
        let end = self.instant(time, step, -NUDGE * self.step);
        let Self { train, limit, memory, .. } = self;
        let mut rates = |at: &Instant, rates: &State, by: f64| {
            train.flow(limit, memory, at, &self.state.after(by, rates)).rates
        };
        let first = begin.rates;
        let second = rates(&middle, &first, 0.5 * step);
        let third = rates(&middle, &second, 0.5 * step);
        let fourth = rates(&end, &third, step);
        self.state = self.state.after(step, &State::runge_kutta_mean(&[first, second, third, fourth]));
        if self.remembers {
            let reached = self.train.fuel_path(&mut self.limit, &self.memory, &end, &self.state);
            self.memory.rack.advance(reached.fuel, step);
            self.memory.torque.advance(reached.demand, step);
            if self.delay.acts() {
                self.delay.push(time + step, reached.command.rack);
                self.note_breaks(time + step);
            }
        }
    }

    /// A continuous governor's command bends where a sample of the set point reaches it.
    fn note_breaks(&mut self, time: f64) {
        let since = (time - self.set_point.dead_time) / self.run.dt;
        if (since - since.round()).abs() * self.run.dt < SAME * self.step {
            self.delay.push_break(time);
        }
    }

    fn record(&self, flow: &Flow, sample: usize, output: &mut [f64], samples: usize) -> Result<()> {
        let row = [
            ("n_e", flow.engine_speed),
            ("n_s", self.state.propeller),
            ("M_b", flow.brake),
            ("M_g", flow.gauge),
            ("M_s", flow.shaft),
            ("X_f", flow.rack),
            ("E_n", self.state.error),
            ("the ship's speed", self.state.ship),
        ];
        for (place, (what, value)) in row.into_iter().enumerate() {
            if !value.is_finite() {
                return Err(Error::Diverged { sample, time: sample as f64 * self.run.dt, what });
            }
            output[place * samples + sample] = value;
        }
        Ok(())
    }
}
