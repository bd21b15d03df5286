//! Steps of the classical Runge-Kutta method, which end where signals jump or bend: at delayed samples and the governor's.

use crate::error::Result;
use crate::stepper::Envelope;
use crate::stop::Stop;
use crate::subnormal::{CUT_EVERY, cut};

use super::delay::Delay;
use super::governor::{self, Timing};
use super::motion::{Flow, Instant, Memory};
use super::set_point::SetPoint;
use super::{DriveTrain, Run, State};

/// Number of outputs.
pub const ROWS: usize = 8;

/// Names of the outputs for messages: `n_e`, `n_s` [rev/s], `M_b`, `M_g`, `M_s` [Nm], `X_f` [mm], `E_n` [rev], ship
/// speed [m/s].
pub const NAMES: [&str; ROWS] = ["n_e", "n_s", "M_b", "M_g", "M_s", "X_f", "E_n", "the ship's speed"];

/// Events closer than this share of a step are at one time.
pub const SAME: f64 = 1e-8;
/// Steps between two looks at the flag to stop.
const LOOK_EVERY: usize = 1 << 10;
/// A time is moved by this share of a step to choose the side of a jump.
const NUDGE: f64 = 1e-6;
/// The error of a time is surely less than so many of its relative roundings.
const ROUNDINGS: f64 = 8.0;

/// A simulation under way.
pub struct March<'a> {
    train: &'a DriveTrain,
    limit: &'a Envelope,
    run: &'a Run<'a>,
    set_point: SetPoint<'a>,
    step: f64,
    state: State,
    memory: Memory,
    delay: Delay,
    governor: governor::Memory,
    /// Time of the governor's last and next sample [s], and of the next sample of the set point to arrive.
    last_sample: f64,
    next_sample: f64,
    next_arrival: f64,
    samples_taken: u64,
    /// Whether the end of each step must be looked at.
    remembers: bool,
}

impl<'a> March<'a> {
    /// Before the first sample.
    #[inline(always)]
    #[must_use]
    pub fn new(train: &'a DriveTrain, limit: &'a Envelope, run: &'a Run<'a>) -> Self {
        let (state, memory) = train.start();
        let step = run.dt / run.substeps as f64;
        let set_point = SetPoint {
            samples: run.set_speed,
            before: train.set_point_before,
            dt: run.dt,
            dead_time: train.set_dead_time,
            hold: run.hold,
        };
        let dead_time = train.actuator.dead_time;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        // Saturates; a capacity only.
        let steps = (dead_time / step).min(1e4) as usize;
        let mut delay = Delay::new(dead_time, memory.held, 2 * steps);
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
                miss: train.set_point_before - state.engine_side * train.gearbox.ratio,
            },
            last_sample: 0.0,
            next_sample: if matches!(train.governor.timing, Timing::Every(_)) { 0.0 } else { f64::INFINITY },
            next_arrival: set_point.next_break(SAME * step),
            samples_taken: 0,
            remembers: delay.acts() || memory.rack.acts() || memory.torque.acts(),
            state,
            memory,
            delay,
        }
    }

    /// From the first sample to the last, each given to `record`.
    ///
    /// # Errors
    /// What `record` finds, or a request to stop.
    #[inline(always)]
    pub fn through(
        mut self,
        mut record: impl FnMut(usize, &[f64; ROWS]) -> Result<()>,
        stop: &Stop,
    ) -> Result<()> {
        let (dt, substeps, samples) = (self.run.dt, self.run.substeps, self.run.set_speed.len());
        let mut time = self.last_sample;
        for step in 0..=(samples - 1) * substeps {
            let (sample, substep) = (step / substeps, step % substeps);
            let border = (sample as f64 + (substep + 1) as f64 / substeps as f64) * dt;
            let mut shown = substep != 0;
            if step % LOOK_EVERY == 0 {
                stop.check()?;
            }
            if !shown {
                time = sample as f64 * dt;
                if sample % CUT_EVERY == 0 {
                    self.cut();
                }
            }
            loop {
                let begin = self.begin(time);
                if !shown {
                    record(sample, &self.row(&begin))?;
                    shown = true;
                    if sample + 1 == samples {
                        return Ok(());
                    }
                }
                let end = self.next_end(time, border, &begin);
                // Time must advance even if rounding puts an event before it.
                let end = if end > time { end } else { border };
                self.advance(time, end - time, &begin);
                time = end;
                if time >= border {
                    break;
                }
            }
        }
        Ok(())
    }

    /// Cut to zero what has decayed.
    #[inline(always)]
    fn cut(&mut self) {
        self.state = self.state.cut();
        let governor::Memory { integrated, filtered, miss } = self.governor;
        self.governor =
            governor::Memory { integrated: cut(integrated), filtered: cut(filtered), miss: cut(miss) };
        self.memory.held = cut(self.memory.held);
    }

    /// Whether a governor that samples at times of its own is to do so.
    #[inline(always)]
    fn is_sample_due(&self, time: f64) -> bool {
        time >= self.next_sample - self.same(time)
    }

    /// Events closer than this are at one time: a share of a step, but more than the rounding of such a late time.
    #[inline(always)]
    fn same(&self, time: f64) -> f64 {
        (SAME * self.step).max(ROUNDINGS * f64::EPSILON * time)
    }

    /// By how much a time is moved to say which side of a jump is meant.
    #[inline(always)]
    fn nudge(&self, time: f64) -> f64 {
        (NUDGE * self.step).max(2.0 * ROUNDINGS * f64::EPSILON * time)
    }

    /// The time at which a step must end, the border at the latest.
    #[inline(always)]
    fn next_end(&mut self, now: f64, border: f64, begin: &Flow) -> f64 {
        let same = self.same(border);
        let soon = now + same;
        if self.next_arrival <= soon {
            self.next_arrival = self.set_point.next_break(soon);
        }
        let mut cut = self.next_arrival.min(self.delay.next_break(soon));
        if self.next_sample > soon && self.next_sample < cut - same {
            cut = self.next_sample;
        }
        // If cylinders fired at the end of the step that passes their angle, the steps would show as a beat.
        let speed = begin.engine_speed;
        let wait = self.memory.firing.left(self.state.crank) / speed;
        if wait > 0.0 && wait < 2.0 * self.step {
            let acceleration = begin.rates.engine_side * self.train.gearbox.ratio;
            let firing = now + wait / (acceleration * wait / speed * 0.5 + 1.0);
            if firing > soon {
                cut = cut.min(firing);
            }
        }
        if border - cut >= same { cut } else { border }
    }

    /// The signals at a time from which a step starts, once what is due there is done.
    #[inline(always)]
    fn begin(&mut self, now: f64) -> Flow {
        if self.delay.acts() {
            self.delay.forget(now);
        }
        let timing = self.train.governor.timing;
        if let Timing::Every(period) = timing
            && self.is_sample_due(now)
        {
            self.samples_taken += 1;
            self.next_sample = self.samples_taken as f64 * period;
            self.sample(now);
        }
        if self.memory.firing.due(self.state.crank) {
            if timing == Timing::AtFiring {
                self.sample(now);
            }
            let mean = self.flow(now).mean;
            // No step is so long that a cylinder fires twice in it, unless the speed has left all bounds.
            for _ in 0..self.train.strength.len() {
                if self.memory.firing.due(self.state.crank) {
                    self.memory.firing.fire(mean);
                }
            }
        }
        let flow = self.flow(now);
        if self.delay.acts() && self.samples_always() {
            self.delay.push(now, flow.command);
        }
        flow
    }

    /// The signals at a time, behind what jumps there.
    #[inline(always)]
    fn flow(&mut self, time: f64) -> Flow {
        let at = self.instant(time, 0.0, self.nudge(time));
        self.train.flow(self.limit, &self.memory, &at, &self.state)
    }

    /// Let the governor compute.
    #[inline(always)]
    fn sample(&mut self, time: f64) {
        let speed = self.state.engine_side * self.train.gearbox.ratio;
        let ceiling = self.train.ceiling(self.limit, speed, self.state.charge);
        let set_speed = self.set_point.at(time, time + self.nudge(time));
        let elapsed = time - self.last_sample;
        let held = self.memory.held;
        self.memory.held =
            self.train.governor.sample(set_speed, speed, &mut self.governor, elapsed, &ceiling);
        self.state.error = self.governor.integrated;
        self.last_sample = time;
        if self.delay.acts() {
            self.delay.push(time, held);
            self.delay.push(time, self.memory.held);
            self.delay.push_break(time);
        }
    }

    #[inline(always)]
    fn instant(&self, begin: f64, elapsed: f64, nudge: f64) -> Instant {
        let time = begin + elapsed;
        Instant {
            elapsed,
            set_speed: if self.samples_always() { self.set_point.at(time, time + nudge) } else { f64::NAN },
            arriving: if self.delay.acts() { Some(self.delay.at(time, nudge)) } else { None },
        }
    }

    /// A step of the classical Runge-Kutta method that starts with `begin`.
    #[inline(always)]
    fn advance(&mut self, time: f64, step: f64, begin: &Flow) {
        let half = step * 0.5;
        let middle = self.instant(time, half, 0.0);
        let end = self.instant(time, step, -self.nudge(time));
        let (mut rates, mut sum) = (begin.rates, begin.rates);
        // One place for the flow: in a closure that is called thrice it is not inlined.
        for stage in 0..3 {
            let last = stage == 2;
            let (at, by, weight) = if last { (&end, step, 1.0) } else { (&middle, half, 2.0) };
            let state = self.state.plus(by, &rates);
            rates = self.train.flow(self.limit, &self.memory, at, &state).rates;
            sum = sum.plus(weight, &rates);
        }
        self.state = self.state.plus(step * (1.0 / 6.0), &sum);
        if self.remembers {
            self.remember(time + step, &end);
        }
    }

    /// Whether the governor computes always.
    #[inline(always)]
    fn samples_always(&self) -> bool {
        self.train.governor.timing == Timing::Continuous
    }

    /// Keep what later steps need of the end of one.
    #[inline(always)]
    fn remember(&mut self, time: f64, at: &Instant) {
        let reached = self.train.fuel_path(self.limit, &self.memory, at, &self.state);
        self.memory.rack.advance(reached.fuel, at.elapsed);
        self.memory.torque.advance(reached.demand, at.elapsed);
        if self.delay.acts() && self.samples_always() {
            self.delay.push(time, reached.command.rack);
            // A continuous governor's command bends where a sample of the set point reaches it.
            let since = (time - self.set_point.dead_time) / self.run.dt;
            if (since - since.round()).abs() * self.run.dt < self.same(time) {
                self.delay.push_break(time);
            }
        }
    }

    /// The outputs, in the order of [`NAMES`].
    #[inline(always)]
    fn row(&self, flow: &Flow) -> [f64; ROWS] {
        let State { propeller, error, ship, .. } = self.state;
        [flow.engine_speed, propeller, flow.brake, flow.gauge, flow.shaft, flow.rack, error, ship]
    }
}

#[cfg(test)]
mod tests;
