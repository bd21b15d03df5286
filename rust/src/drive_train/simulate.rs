//! A drive train simulated into rows.

use pulp::{Simd, WithSimd};

use crate::error::{Error, Result, require};
use crate::hold::Hold;
use crate::instruction_set::arch;
use crate::stepper::Envelope;
use crate::stop::Stop;

use super::DriveTrain;
use super::event_stepper::{March, NAMES, ROWS, SAME};
use super::governor::Timing;

/// Shortest step, in relative roundings of the record's length: events within a step must have times of their own.
const RESOLUTION: f64 = 1e4;

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
    /// Where the sample time is not positive, there are no steps or no samples, steps are too short to have times of their
    /// own, or a set point is not finite.
    pub fn check(&self) -> Result<()> {
        let Self { set_speed, dt, substeps, .. } = *self;
        require(dt.is_finite() && dt > 0.0, || format!("dt is {dt}, expected a positive sample time [s]"))?;
        require(substeps > 0, || "substeps is 0, expected at least 1".to_owned())?;
        require(!set_speed.is_empty(), || "n_set has no samples, expected at least 1".to_owned())?;
        let (step, end) = (dt / substeps as f64, dt * set_speed.len() as f64);
        require(step >= RESOLUTION * f64::EPSILON * end, || {
            format!(
                "substeps is {substeps}: found steps of {step} s in a record of {end} s, expected longer ones; use fewer substeps"
            )
        })?;
        match set_speed.iter().position(|value| !value.is_finite()) {
            None => Ok(()),
            Some(bad) => Err(Error::Invalid(format!(
                "n_set is {} at sample {bad}, expected finite speeds [rev/s]",
                set_speed[bad]
            ))),
        }
    }

    /// Refuse steps longer than a time within which something happens.
    ///
    /// # Errors
    /// Where the dead time of the fuel or the governor's period is shorter than a step.
    pub fn check_steps(&self, train: &DriveTrain) -> Result<()> {
        let step = self.dt / self.substeps as f64;
        let fits = |name: &str, time: f64| {
            require(time == 0.0 || time >= step * (1.0 - SAME), || {
                format!(
                    "parameters: {name} is {time} s, expected 0 or at least a step, {step} s; use more substeps"
                )
            })
        };
        fits("fuel_dead_time", train.actuator.dead_time)?;
        if let Timing::Every(period) = train.governor.timing {
            fits("governor_period", period)
        } else {
            Ok(())
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
    run.check()?;
    run.check_steps(train)?;
    let (samples, length) = (run.set_speed.len(), ROWS * run.set_speed.len());
    require(output.len() == length, || format!("output has {} values, expected {length}", output.len()))?;
    arch().dispatch(Rows { train, envelope, run, output, samples, stop })
}

/// Compiled for the machine's instructions, among them that of rounding.
struct Rows<'a> {
    train: &'a DriveTrain,
    envelope: &'a Envelope,
    run: &'a Run<'a>,
    output: &'a mut [f64],
    samples: usize,
    stop: &'a Stop,
}

impl WithSimd for Rows<'_> {
    type Output = Result<()>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> Result<()> {
        let Self { train, envelope, run, output, samples, stop } = self;
        let record = |sample: usize, row: &[f64; ROWS]| {
            for (place, &value) in row.iter().enumerate() {
                if !value.is_finite() {
                    let what = NAMES[place];
                    return Err(Error::Diverged { sample, time: sample as f64 * run.dt, what });
                }
                output[place * samples + sample] = value;
            }
            Ok(())
        };
        March::new(train, envelope, run).through(record, stop)
    }
}
