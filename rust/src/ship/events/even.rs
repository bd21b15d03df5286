//! Ships with a torque limit, where a millionth of a step does not count: even steps, nothing located.
//!
//! Where a limit takes hold or lets go, the torque bends but does not jump. A step of the Runge-Kutta method across that instant is
//! wrong by the bend times the square of its length, far below any noise. Derivatives are those of the computation as it is done: of
//! a record whose set point breaks at every sample they are good to some per cent, since they jump where the limit takes hold.

use pulp::Simd;

use crate::error::Result;
use crate::integrate::Hold;
use crate::scalar::{Dual, Scalar, smaller};
use crate::ship::march::Consume;
use crate::ship::output::Output;
use crate::ship::run::Run;

use super::flow::{Equations, State};
use super::march::March;
use super::readings::Readings;
use super::terms::Side;

/// Fewest steps a sample: a jump of the set point takes a sample or two, and how late it comes must show.
const FEWEST: f64 = 2.0;
/// Length of a step over what `longest_step` returns.
const LONGER: f64 = 3.0;
/// Steps between looks at the stop flag.
const LOOK_EVERY: usize = 1024;
/// Parts of a step by which a reading may miss its end.
const SAME: f64 = 1e-9;

/// Whether a ship is of this kind.
pub(super) fn is_even<T: Scalar>(equations: &Equations<T>, outputs: &[Output], run: &Run<'_>) -> bool {
    let e = &equations.elements;
    let more = e.sampled || e.derivative || e.rate_limit || e.rack_limit || e.anti_windup;
    let plain = e.torque_limit && !more && (e.delayed || equations.terms.t_d.is_zero());
    plain && !run.sharp && run.hold == Hold::First && !outputs.contains(&Output::Sum)
}

/// The set point with its integral.
struct Summed<'a> {
    samples: &'a [f64],
    sums: Vec<f64>,
    dt: f64,
}

impl<'a> Summed<'a> {
    fn new(samples: &'a [f64], dt: f64) -> Self {
        let mut sums = Vec::with_capacity(samples.len());
        let mut sum = 0.0;
        for (k, &sample) in samples.iter().enumerate() {
            sum += if k > 0 { 0.5 * dt * (samples[k - 1] + sample) } else { 0.0 };
            sums.push(sum);
        }
        Self { samples, sums, dt }
    }

    /// The sample at a time or before.
    #[inline(always)]
    fn sample(&self, time: f64) -> usize {
        let place = time / self.dt + SAME;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // Not negative; saturates.
        (place.max(0.0) as usize).min(self.samples.len() - 1)
    }

    /// The slope behind a sample.
    #[inline(always)]
    fn slope(&self, k: usize) -> f64 {
        self.samples.get(k + 1).map_or(0.0, |next| (next - self.samples[k]) / self.dt)
    }

    /// Value, slope and integral at a time; the ends of the record hold. At a sample it has the mean slope of both sides:
    /// a time that moves sees as much of each.
    #[inline(always)]
    fn at(&self, time: f64) -> [f64; 3] {
        let k = self.sample(time);
        let (from, passed) = (self.samples[k], time - k as f64 * self.dt);
        let slope = if passed < -SAME * self.dt { 0.0 } else { self.slope(k) };
        let value = from + slope * passed;
        let sum = self.sums[k] + passed * (from + 0.5 * slope * passed);
        if passed.abs() > SAME * self.dt {
            return [value, slope, sum];
        }
        let behind = if k == 0 { 0.0 } else { self.slope(k - 1) };
        [value, 0.5 * (behind + slope), sum]
    }
}

/// Everything at an instant.
#[derive(Clone, Copy)]
struct Now<T> {
    rates: State<T>,
    rack: T,
    brake: T,
    gauge: T,
}

/// The end of a step.
type End<T> = (State<T>, Now<T>);

/// The drive train with what is the same in all steps. Of a [`State`], `sum` is the integral of the speed's deviation here.
struct Even<'a, T> {
    equations: &'a Equations<T>,
    set: Summed<'a>,
    load: &'a [f64],
    dt: f64,
    step: f64,
    per_inertia: T,
    per_propeller: T,
    per_twist: T,
    per_lag: T,
    standing: T,
    before: T,
    /// What went back into the governor at the ends of the last steps, and its slope; the number of steps so far.
    past: Vec<[T; 2]>,
    last: usize,
}

impl<S: Simd, const N: usize> Even<'_, Dual<S, N>> {
    /// What the rack is fed from outside the loop; None before the record has come through the dead time.
    #[inline(always)]
    fn fed(&self, time: Dual<S, N>) -> Option<Dual<S, N>> {
        let t = &self.equations.terms;
        let late = time - t.t_d;
        if late.value() < 0.0 {
            return None;
        }
        let at = late - t.t_set;
        let [value, slope, sum] = self.set.at(at.value());
        let (set, summed) = (at.function(value, slope), at.function(sum, value));
        let summed = t.s_u * (summed + t.t_set * self.set.samples[0]);
        Some(self.standing + t.k_p * (t.s_u * set + -1.0) + t.k_i * (summed - late))
    }

    /// What went back a dead time ago: the cubic through the ends of its step, and a line beyond the last one.
    #[inline(always)]
    fn back(&self, time: Dual<S, N>) -> Dual<S, N> {
        let late = time - self.equations.terms.t_d;
        let (h, last, mask) = (self.step, self.last, self.past.len() - 1);
        let place = late.value() / h;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // Saturates.
        let k = place.max(0.0) as usize;
        if k >= last {
            let [from, slope] = self.past[last & mask];
            let beyond = late + -(last as f64 * h);
            return from + slope * beyond;
        }
        let ([y, dy], [z, dz]) = (self.past[k & mask], self.past[(k + 1) & mask]);
        let s = place - k as f64;
        let r = 1.0 - s;
        let (first, second) = (h * s * r * r, -h * s * s * r);
        let level = s * s * (3.0 - 2.0 * s);
        let value = y * (1.0 - level) + z * level + dy * first + dz * second;
        let slope = 6.0 * s * r / h * (z.value() - y.value())
            + r * (1.0 - 3.0 * s) * dy.value()
            + s * (3.0 * s - 2.0) * dz.value();
        value + late.function(0.0, slope)
    }

    #[inline(always)]
    fn returned(&self, state: &State<Dual<S, N>>) -> Dual<S, N> {
        self.equations.terms.k_p * (state.engine + -1.0) + self.equations.terms.k_i * state.sum
    }

    /// Outside feed less what went back, of a governor behind a dead time.
    #[inline(always)]
    fn arriving(&self, time: Dual<S, N>) -> Option<Dual<S, N>> {
        let fed = self.fed(time);
        if self.equations.elements.delayed { fed.map(|fed| fed - self.back(time)) } else { fed }
    }

    /// Remember what goes back at the end of a step.
    #[inline(always)]
    fn note(&mut self, step: usize, state: &State<Dual<S, N>>, rate: Dual<S, N>) {
        let t = &self.equations.terms;
        let slope = t.k_p * rate + t.k_i * (state.engine + -1.0);
        let (mask, entry) = (self.past.len() - 1, [self.returned(state), slope]);
        self.past[step & mask] = entry;
        self.last = step;
    }

    #[inline(always)]
    fn now(&self, time: f64, arriving: Option<Dual<S, N>>, state: &State<Dual<S, N>>) -> Now<Dual<S, N>> {
        let (t, elements) = (&self.equations.terms, &self.equations.elements);
        let zero = t.g.constant(0.0);
        let speed = state.engine + -1.0;
        let command = match arriving {
            None => self.before,
            Some(arriving) if elements.delayed => arriving,
            Some(fed) => fed - self.returned(state),
        };
        let (rack, rack_rate) =
            if elements.lag { (state.rack, (command - state.rack) * self.per_lag) } else { (command, zero) };
        let raw = t.g * speed + t.v * rack + 1.0;
        let upper = smaller(self.equations.torque_limit(Side::High, state.engine), raw);
        let brake = if upper.value() < t.m_min.value() { t.m_min } else { upper };
        let driven = if elements.flexible { state.propeller } else { state.engine };
        let mut load = driven.power(t.p);
        if !t.damping.is_zero() {
            load = load + t.damping * (driven + -1.0);
        }
        if elements.loaded {
            load = load + t.load_gain * self.load_at(time);
        }
        let (engine, propeller, spring, gauge);
        if elements.flexible {
            let slip = state.engine - state.propeller;
            let twisting = state.spring + t.zeta_twist * slip;
            engine = (brake - twisting) * self.per_inertia;
            (propeller, spring, gauge) =
                ((twisting - load) * self.per_propeller, slip * self.per_twist, twisting);
        } else {
            engine = (brake - load) * self.per_inertia;
            (propeller, spring, gauge) = (zero, zero, load + t.tau_prop * engine);
        }
        let rates = State { engine, propeller, spring, sum: speed, rack: rack_rate };
        Now { rates, rack, brake, gauge }
    }

    #[inline(always)]
    fn load_at(&self, time: f64) -> f64 {
        let last = self.load.len() - 1;
        let place = (time / self.dt).max(0.0);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // Not negative; saturates.
        let k = (place as usize).min(last);
        let next = self.load[(k + 1).min(last)];
        self.load[k] + (place - k as f64).min(1.0) * (next - self.load[k])
    }

    /// One step on, by the classical Runge-Kutta method.
    #[inline(always)]
    fn moved(
        &self,
        start: f64,
        from: &End<Dual<S, N>>,
        inputs: &[Option<Dual<S, N>>; 2],
    ) -> State<Dual<S, N>> {
        let (state, now) = from;
        let h = self.step;
        let after = |rates: &State<Dual<S, N>>, length: f64, state: &State<Dual<S, N>>| State {
            engine: state.engine + rates.engine * length,
            propeller: state.propeller + rates.propeller * length,
            spring: state.spring + rates.spring * length,
            sum: state.sum + rates.sum * length,
            rack: state.rack + rates.rack * length,
        };
        let mut end = after(&now.rates, h / 6.0, state);
        let mut probe = after(&now.rates, 0.5 * h, state);
        for (at, next, weight, input) in
            [(0.5, 0.5, 2.0, inputs[0]), (0.5, 1.0, 2.0, inputs[0]), (1.0, 0.0, 1.0, inputs[1])]
        {
            let rates = self.now(start + at * h, input, &probe).rates;
            end = after(&rates, weight * h / 6.0, &end);
            if next > 0.0 {
                probe = after(&rates, next * h, state);
            }
        }
        end.map(Dual::without_dust)
    }
}

/// The state between two ends of a step: the cubic with their rates.
#[inline(always)]
fn between<S: Simd, const N: usize>(
    [from, to]: [&End<Dual<S, N>>; 2],
    place: Dual<S, N>,
    h: f64,
) -> State<Dual<S, N>> {
    let of = |pick: fn(&State<Dual<S, N>>) -> Dual<S, N>| {
        let (y, z) = (pick(&from.0), pick(&to.0));
        let (dy, dz) = (pick(&from.1.rates) * h, pick(&to.1.rates) * h);
        let rest = place * -1.0 + 1.0;
        let bend = rest * (dy - (z - y)) + place * ((z - y) - dz);
        y + place * ((z - y) + rest * bend)
    };
    State {
        engine: of(|state| state.engine),
        propeller: of(|state| state.propeller),
        spring: of(|state| state.spring),
        sum: of(|state| state.sum),
        rack: of(|state| state.rack),
    }
}

impl<S: Simd, const N: usize> March<'_, S, N> {
    /// The drive train in steps of so many seconds, so many in all.
    #[inline(always)]
    fn even(&self, h: f64, steps: f64) -> Even<'_, Dual<S, N>> {
        let (equations, run) = (&self.equations, self.run);
        let t = &equations.terms;
        let (zero, one) = (t.g.constant(0.0), t.g.constant(1.0));
        let flexible = equations.elements.flexible;
        let engine = if flexible { t.tau_n - t.tau_prop } else { t.tau_n };
        let over = |acts: bool, time: Dual<S, N>| if acts { one / time } else { one };
        Even {
            equations,
            set: Summed::new(run.set, run.dt),
            load: run.load,
            dt: run.dt,
            step: h,
            per_inertia: one / engine,
            per_propeller: over(flexible, t.tau_prop),
            per_twist: over(flexible, t.tau_twist),
            per_lag: over(equations.elements.lag, t.tau_act),
            standing: t.initial_fuel / t.v - t.k_p * (t.s_u * run.set[0] - t.initial_speed),
            before: t.initial_fuel / t.v,
            past: vec![[zero; 2]; even_places(self.plain.terms.t_d / h, steps)],
            last: 0,
        }
    }

    /// Through the record in even steps.
    ///
    /// # Errors
    /// What `consume` finds, or a request to stop.
    #[inline(always)]
    pub(super) fn through_even(
        &self,
        readings: &mut Readings<Dual<S, N>, N>,
        consume: &mut Consume<'_>,
    ) -> Result<()> {
        let (equations, run) = (&self.equations, self.run);
        let (t, flexible) = (&equations.terms, equations.elements.flexible);
        let parts = (run.dt / (LONGER * self.longest)).ceil().max(FEWEST);
        let h = run.dt / parts;
        let zero = t.g.constant(0.0);
        let mut even = self.even(h, run.samples() as f64 * parts);
        let state = State { sum: zero, ..self.state };
        even.note(0, &state, zero);
        let mut to = (state, even.now(0.0, even.arriving(zero), &state));
        even.note(0, &state, to.1.rates.engine);
        let (mut from, mut step) = (to, 0_usize);
        while let Some((channel, reading)) = readings.next() {
            while step == 0 || reading.value() > (step as f64 + SAME) * h {
                if step.is_multiple_of(LOOK_EVERY) {
                    self.stop.check()?;
                }
                from = to;
                let start = step as f64 * h;
                let inputs = [0.5, 1.0].map(|part| even.arriving(zero.constant(start + part * h)));
                let state = even.moved(start, &from, &inputs);
                step += 1;
                to = (state, even.now(step as f64 * h, inputs[1], &state));
                even.note(step, &state, to.1.rates.engine);
            }
            let at = reading.value() - step as f64 * h;
            let (state, now) = if at.abs() <= SAME * h && reading.is_constant() {
                to
            } else {
                let place = (reading + -((step - 1) as f64 * h)) * (1.0 / h);
                let state = between([&from, &to], place, h);
                (state, even.now(reading.value(), even.arriving(reading), &state))
            };
            for place in 0..readings.channels[channel].outputs.len() {
                let output = readings.channels[channel].outputs[place];
                let number = match self.outputs[output] {
                    Output::PropellerSpeed if flexible => state.propeller + -1.0,
                    Output::Speed | Output::PropellerSpeed | Output::Sum => state.engine + -1.0,
                    Output::EngineTorque => t.s_m * now.brake + -1.0,
                    Output::GaugeTorque => t.s_m * now.gauge + -1.0,
                    Output::Rack => now.rack,
                };
                readings.push(output, number.tangent());
            }
            readings.advance(channel);
            readings.give(consume)?;
        }
        readings.give(consume)
    }
}

/// Steps to be remembered for a dead time of so many, of so many in all; a power of two.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // Positive, and bounded by the record.
fn even_places(dead_time: f64, steps: f64) -> usize {
    (dead_time.min(steps) as usize + 4).next_power_of_two()
}
