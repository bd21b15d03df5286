//! The most frequent ship with events: a governor that samples, a rigid shaft, and nothing else that switches.
//!
//! Between two commands the fuel is constant and the speed a series, which is read where it is asked for: only commands end a step.

use pulp::Simd;

use crate::error::Result;
use crate::scalar::{Dual, Scalar};
use crate::ship::march::Consume;
use crate::ship::output::Output;

use super::march::March;
use super::readings::Readings;
use super::rise::{Rise, Shaft};

/// Most series in a sample of the record.
const MOST_SERIES: f64 = 65_536.0;
/// Events between looks at the stop flag.
const LOOK_EVERY: usize = 4096;

impl<S: Simd, const N: usize> March<'_, S, N> {
    /// Whether the ship is of this kind.
    pub(super) fn is_simple(&self) -> bool {
        let e = &self.equations.elements;
        let limits = e.lag || e.rate_limit || e.rack_limit || e.torque_limit;
        e.sampled && !(limits || e.derivative || e.flexible || e.loaded)
    }

    /// Through the record as far as series hold.
    ///
    /// # Errors
    /// What `consume` finds, or a request to stop.
    #[inline(always)]
    pub(super) fn through_series(
        &mut self,
        simd: S,
        readings: &mut Readings<Dual<S, N>, N>,
        consume: &mut Consume<'_>,
    ) -> Result<()> {
        let shaft = Shaft::new(simd, self.equations.terms, self.run.dt / MOST_SERIES);
        let (t_s, t_0) = (self.plain.terms.t_s, self.plain.terms.t_0);
        let mut count = 0_usize;
        let mut rise = Rise::new(&shaft, self.now, self.state.engine, shaft.terms.v * self.held);
        while let (Some(series), Some((channel, reading))) = (&rise, readings.next()) {
            count += 1;
            if count.is_multiple_of(LOOK_EVERY) {
                self.stop.check()?;
            }
            let arrival = self.arrivals.next();
            let arriving = arrival.map_or(f64::INFINITY, Scalar::value);
            let sample = t_0 + t_s * self.sample;
            let read = reading.value();
            let same = self.same(read);
            let first = sample.min(arriving).min(read);
            if first > series.end {
                let time = reading.constant(series.end);
                rise = self.rebased(&shaft, series, time);
            } else if sample <= arriving + same && sample <= read + same {
                let time = shaft.terms.t_0 + shaft.terms.t_s * self.sample;
                let speed = series.at(&shaft, time);
                self.order(time, speed, None);
            } else if arriving <= read + same {
                let time = arrival.unwrap_or(reading);
                let speed = series.at(&shaft, time);
                self.arrive();
                (self.now, self.state.engine) = (time, speed.without_dust());
                rise = Rise::new(&shaft, time, self.state.engine, shaft.terms.v * self.held);
            } else {
                let speed = series.at(&shaft, reading);
                for place in 0..readings.channels[channel].outputs.len() {
                    let output = readings.channels[channel].outputs[place];
                    let number = self.read(&shaft, series, self.outputs[output], speed, reading);
                    readings.push(output, number.tangent());
                }
                readings.advance(channel);
                readings.give(consume)?;
            }
        }
        Ok(())
    }

    /// A series from a time on at which nothing happens.
    #[inline(always)]
    fn rebased(&mut self, shaft: &Shaft<S, N>, series: &Rise<S, N>, time: Dual<S, N>) -> Option<Rise<S, N>> {
        let speed = series.at(shaft, time).without_dust();
        (self.now, self.state.engine) = (time, speed);
        Rise::new(shaft, time, speed, series.fuel)
    }

    /// An output at a time at which the speed is known.
    #[inline(always)]
    fn read(
        &self,
        shaft: &Shaft<S, N>,
        series: &Rise<S, N>,
        output: Output,
        speed: Dual<S, N>,
        time: Dual<S, N>,
    ) -> Dual<S, N> {
        let t = &shaft.terms;
        let brake = || t.g * (speed + -1.0) + series.fuel + 1.0;
        match output {
            Output::Speed | Output::PropellerSpeed => speed + -1.0,
            Output::EngineTorque => t.s_m * brake() + -1.0,
            Output::GaugeTorque => {
                // What the engine's own inertia takes does not reach the gauge.
                let rate = series.rate_at(shaft, time);
                t.s_m * (brake() - (t.tau_n - t.tau_prop) * rate) + -1.0
            }
            Output::Rack => self.held,
            Output::Sum => self.state.sum,
        }
    }
}
