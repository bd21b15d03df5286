//! A simulation over a record.

use pulp::{Simd, WithSimd};

use crate::error::{Error, Result, require};
use crate::finite::all_finite;
use crate::hold::Hold;
use crate::instruction_set::arch;
use crate::stop::Stop;
use crate::subnormal::cut;

use super::detail::Detail;
use super::envelope::Envelope;
use super::late::Late;
use super::output::{OUTPUTS, Output};
use super::parameters::{Parameters, at};
use super::step::Ship;

/// Most steps per sample.
const MOST_SUBSTEPS: usize = 1 << 16;

/// Steps between two checks for a stop: less than a millisecond.
const STEPS_BETWEEN_CHECKS: usize = 1024;

/// Inputs of a record, and the simulation steps.
#[derive(Debug, Clone, Copy)]
pub struct Run<'a> {
    /// Set point over the operating point's speed.
    pub set: &'a [f64],
    /// Deviation of the measured load torque; empty if no load is measured.
    pub load: &'a [f64],
    /// Sample time [s].
    pub dt: f64,
    /// Steps per sample.
    pub substeps: usize,
    /// Course of set point and load between samples.
    pub hold: Hold,
    /// Highest torque by speed, relative to the operating point, instead of `M_max`.
    pub envelope: Option<&'a Envelope>,
    /// Additional elements of a whole drive train.
    pub detail: Option<&'a Detail>,
}

impl<'a> Run<'a> {
    /// Validate the inputs.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a set point without samples, a load of another length, values that are not finite, a sample
    /// time that is not positive, or no substep or too many.
    pub fn new(set: &'a [f64], load: &'a [f64], dt: f64, substeps: usize, hold: Hold) -> Result<Self> {
        require(!set.is_empty(), || "u has no samples, expected at least 1".to_owned())?;
        require(load.is_empty() || load.len() == set.len(), || {
            format!("load has {} samples, expected none or {}, those of u", load.len(), set.len())
        })?;
        require(dt.is_finite() && dt > 0.0, || format!("dt is {dt}, expected a positive sample time [s]"))?;
        require((1..=MOST_SUBSTEPS).contains(&substeps), || {
            format!("substeps is {substeps}, expected 1 to {MOST_SUBSTEPS}")
        })?;
        for (name, values) in [("u", set), ("load", load)] {
            if !all_finite(values) {
                let bad = values.iter().position(|value| !value.is_finite()).unwrap_or_default();
                return Err(Error::Invalid(format!(
                    "{name}[{bad}] is {}, expected a finite number; bridge gaps before",
                    values[bad]
                )));
            }
        }
        Ok(Self { set, load, dt, substeps, hold, envelope: None, detail: None })
    }

    /// This run with a torque-speed envelope.
    #[must_use]
    pub fn below(self, envelope: &'a Envelope) -> Self {
        Self { envelope: (!envelope.is_unlimited()).then_some(envelope), ..self }
    }

    /// Check that the torque has at most one upper limit.
    ///
    /// # Errors
    /// [`Error::Invalid`] for both an envelope and `M_max`.
    pub fn check(&self, parameters: &Parameters) -> Result<()> {
        require(self.envelope.is_none() || parameters.is_off(at::M_MAX), || {
            "found M_max beside an envelope, expected one of them".to_owned()
        })?;
        let filters = self.detail.is_none_or(Detail::filters);
        require(filters || parameters.is_off(at::K_D), || {
            "detail: found T_f = 0, expected a positive number beside K_d".to_owned()
        })
    }

    /// Step length [s].
    #[must_use]
    pub fn step(&self) -> f64 {
        self.dt / self.substeps as f64
    }

    /// Approximate number of steps of a simulation.
    #[must_use]
    pub const fn work(&self) -> usize {
        self.set.len().saturating_mul(self.substeps)
    }
}

/// Simulate a ship into rows of the outputs, `[output, sample]`.
///
/// # Errors
/// [`Error::Invalid`] for two upper limits or insufficient memory, [`Error::Diverged`] if the simulation diverges,
/// [`Error::Stopped`] on request.
pub fn simulate(
    parameters: &Parameters,
    run: &Run<'_>,
    outputs: &[Output],
    rows: &mut [f64],
    stop: &Stop,
) -> Result<()> {
    run.check(parameters)?;
    let length = run.set.len() * outputs.len();
    require(rows.len() == length, || format!("found room for {} values, expected {length}", rows.len()))?;
    let march = March { parameters, run, outputs, rows, stop };
    if run.detail.is_some() {
        arch().dispatch(Dispatched::<true>(march))
    } else {
        arch().dispatch(Dispatched::<false>(march))
    }
}

struct March<'a, 'b> {
    parameters: &'a Parameters,
    run: &'a Run<'b>,
    outputs: &'a [Output],
    rows: &'a mut [f64],
    stop: &'a Stop,
}

struct Dispatched<'a, 'b, const D: bool>(March<'a, 'b>);

impl<const D: bool> WithSimd for Dispatched<'_, '_, D> {
    type Output = Result<()>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> Result<()> {
        let March { parameters, run, outputs, rows, stop } = self.0;
        let mut ship = Ship::<D>::new(parameters, run);
        let mut late = Late::new(&ship, outputs, run.step());
        let samples = run.set.len();
        let mut unchecked = 0;
        for sample in 0..samples {
            if let Some(late) = &mut late {
                late.push(&ship, outputs);
            }
            let mut is_sound = ship.is_sound();
            for (channel, (row, &output)) in rows.chunks_exact_mut(samples).zip(outputs).enumerate() {
                row[sample] =
                    cut(late.as_ref().map_or_else(|| ship.output(output), |late| late.read(channel)));
                is_sound &= row[sample].is_finite();
            }
            ship.cut();
            if !is_sound {
                let what = outputs.first().map_or("dn", |&output| OUTPUTS[output as usize]);
                return Err(Error::Diverged { sample, time: sample as f64 * run.dt, what });
            }
            if sample + 1 == samples {
                break;
            }
            for step in 1..=run.substeps {
                ship.step();
                unchecked += 1;
                if unchecked == STEPS_BETWEEN_CHECKS {
                    unchecked = 0;
                    stop.check()?;
                }
                if let (Some(late), true) = (&mut late, step < run.substeps) {
                    late.push(&ship, outputs);
                }
            }
        }
        Ok(())
    }
}
