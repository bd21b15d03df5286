//! A simulation as a march through a record, with lanes of derivatives.

use pulp::{Simd, WithSimd};

use crate::error::{Error, Result, require};
use crate::finite::all_finite;
use crate::hold::Hold;
use crate::instruction_set::arch;
use crate::scalar::{Dual, Scalar, Tangent};
use crate::stop::Stop;

use super::detail::Detail;
use super::envelope::Envelope;
use super::late::Late;
use super::output::{OUTPUTS, Output};
use super::parameters::{Parameters, at};
use super::step::Ship;

/// Most steps a sample that can be asked for.
const MOST_SUBSTEPS: usize = 1 << 16;
/// Most directions of derivatives.
pub const MOST_DIRECTIONS: usize = 24;

/// Steps after which a request to stop is looked for: less than a millisecond.
const STEPS_BETWEEN_CHECKS: usize = 1024;

/// A record's inputs and the steps through them.
#[derive(Debug, Clone, Copy)]
pub struct Run<'a> {
    /// Set point over the operating point's speed.
    pub set: &'a [f64],
    /// Deviation of the measured load torque; empty without one.
    pub load: &'a [f64],
    /// Sample time [s].
    pub dt: f64,
    /// Steps a sample.
    pub substeps: usize,
    /// Of both inputs between samples.
    pub hold: Hold,
    /// Every so manieth sample is seen.
    pub stride: usize,
    /// Highest torque by speed, both over the operating point's, in place of `M_max`.
    pub envelope: Option<&'a Envelope>,
    /// What only a whole drive train has.
    pub detail: Option<&'a Detail>,
}

impl<'a> Run<'a> {
    /// Check and collect.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a set point without samples, a load of another length, a value that is not finite, a sample time
    /// that is not positive, no substep or too many, or no stride.
    pub fn new(
        set: &'a [f64],
        load: &'a [f64],
        dt: f64,
        substeps: usize,
        hold: Hold,
        stride: usize,
    ) -> Result<Self> {
        require(!set.is_empty(), || "u has no samples, expected at least 1".to_owned())?;
        require(load.is_empty() || load.len() == set.len(), || {
            format!("load has {} samples, expected none or {}, those of u", load.len(), set.len())
        })?;
        require(dt.is_finite() && dt > 0.0, || format!("dt is {dt}, expected a positive sample time [s]"))?;
        require((1..=MOST_SUBSTEPS).contains(&substeps), || {
            format!("substeps is {substeps}, expected 1 to {MOST_SUBSTEPS}")
        })?;
        require(stride > 0, || "stride is 0, expected 1 or more".to_owned())?;
        for (name, values) in [("u", set), ("load", load)] {
            if !all_finite(values) {
                let bad = values.iter().position(|value| !value.is_finite()).unwrap_or_default();
                return Err(Error::Invalid(format!(
                    "{name}[{bad}] is {}, expected a finite number; bridge gaps before",
                    values[bad]
                )));
            }
        }
        Ok(Self { set, load, dt, substeps, hold, stride, envelope: None, detail: None })
    }

    /// Below a torque-speed envelope.
    #[must_use]
    pub fn below(self, envelope: &'a Envelope) -> Self {
        Self { envelope: (!envelope.is_unlimited()).then_some(envelope), ..self }
    }

    /// Refuse two upper limits.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an envelope beside `M_max`.
    pub fn check(&self, parameters: &Parameters) -> Result<()> {
        require(self.envelope.is_none() || parameters.is_off(at::M_MAX), || {
            "found M_max beside an envelope, expected one of them".to_owned()
        })?;
        let filters = self.detail.is_none_or(Detail::filters);
        require(filters || parameters.is_off(at::K_D), || {
            "detail: found T_f = 0, expected a positive number beside K_d".to_owned()
        })
    }

    /// The step [s].
    #[must_use]
    pub fn step(&self) -> f64 {
        self.dt / self.substeps as f64
    }

    /// Number of samples that are seen.
    #[must_use]
    pub const fn seen(&self) -> usize {
        self.set.len().div_ceil(self.stride)
    }
}

/// What is simulated, and by what it is differentiated.
#[derive(Debug, Clone, Copy)]
pub struct Task<'a> {
    /// The ship.
    pub parameters: Parameters,
    /// Signals wanted.
    pub outputs: &'a [Output],
    /// Places of parameters.
    pub wrt: &'a [usize],
}

impl Task<'_> {
    /// Roughly how many steps with a derivative a simulation takes.
    #[must_use]
    pub fn work(&self, run: &Run<'_>) -> usize {
        run.set.len().saturating_mul(run.substeps).saturating_mul(1 + self.wrt.len())
    }
}

/// Simulate: rows of one sample each, `[sample, output, 1 + wrt]`, the output before its derivatives.
///
/// # Errors
/// [`Error::Invalid`] for what can't be differentiated by or too many directions, [`Error::Diverged`] where the ship runs away,
/// [`Error::Stopped`] on request.
pub fn simulate(task: &Task<'_>, run: &Run<'_>, rows: &mut [f64], stop: &Stop) -> Result<()> {
    task.parameters.check_wrt(task.wrt)?;
    run.check(&task.parameters)?;
    let length = run.seen() * task.outputs.len() * (1 + task.wrt.len());
    require(rows.len() == length, || format!("found room for {} values, expected {length}", rows.len()))?;
    require(task.wrt.len() <= MOST_DIRECTIONS, || {
        format!("wrt has {} entries, expected at most {MOST_DIRECTIONS}", task.wrt.len())
    })?;
    let march = March { task, run, rows, stop };
    match task.wrt.len() {
        0 if run.detail.is_some() => arch().dispatch(Plain::<true>(march)),
        0 => arch().dispatch(Plain::<false>(march)),
        1..=8 => arch().dispatch(Wide::<8>(march)),
        9..=16 => arch().dispatch(Wide::<16>(march)),
        _ => arch().dispatch(Wide::<24>(march)),
    }
}

struct March<'a, 'b> {
    task: &'a Task<'a>,
    run: &'a Run<'b>,
    rows: &'a mut [f64],
    stop: &'a Stop,
}

struct Wide<'a, 'b, const N: usize>(March<'a, 'b>);

impl<const N: usize> WithSimd for Wide<'_, '_, N> {
    type Output = Result<()>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Result<()> {
        let March { task, run, rows, stop } = self.0;
        let zero = Dual::<S, N>::new(simd, Tangent { value: 0.0, slopes: [0.0; N] });
        let number = |place: usize| {
            let value = task.parameters.of(place);
            // A rate limit acts alike both ways where it is one parameter.
            task.wrt
                .iter()
                .position(|&by| {
                    by == place
                        || (by == at::RATE_UP
                            && place == at::RATE_DOWN
                            && value == task.parameters.of(at::RATE_UP))
                })
                .map_or(zero.constant(value), |lane| zero.along(value, lane))
        };
        let ship = Ship::<_, false>::new(&task.parameters, run, task.wrt, number);
        let directions = task.wrt.len();
        march(ship, task, run, rows, stop, |number, row: &mut [f64]| {
            let tangent = number.tangent();
            row[0] = tangent.value;
            row[1..].copy_from_slice(&tangent.slopes[..directions]);
        })
    }
}

struct Plain<'a, 'b, const D: bool>(March<'a, 'b>);

impl<const D: bool> WithSimd for Plain<'_, '_, D> {
    type Output = Result<()>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> Result<()> {
        let March { task, run, rows, stop } = self.0;
        let ship = Ship::<f64, D>::new(&task.parameters, run, &[], |place| task.parameters.of(place));
        march(ship, task, run, rows, stop, |number, row| row[0] = number)
    }
}

#[inline(always)]
fn march<T: Scalar, const D: bool>(
    mut ship: Ship<'_, T, D>,
    task: &Task<'_>,
    run: &Run<'_>,
    rows: &mut [f64],
    stop: &Stop,
    write: impl Fn(T, &mut [f64]),
) -> Result<()> {
    let width = 1 + task.wrt.len();
    let every = run.substeps * run.stride;
    let mut unchecked = 0;
    let mut late = Late::new(&ship, task.outputs, run.step());
    for (seen, row) in rows.chunks_exact_mut(width * task.outputs.len()).enumerate() {
        for (&output, place) in task.outputs.iter().zip(row.chunks_exact_mut(width)) {
            write(ship.output(output).cut(), place);
        }
        if let Some(late) = &mut late {
            late.push(&ship, task.outputs);
            for (channel, place) in row.chunks_exact_mut(width).enumerate() {
                write(late.read(channel).cut(), place);
            }
        }
        ship.cut();
        if !ship.is_sound() || !row.iter().all(|value| value.is_finite()) {
            let sample = seen * run.stride;
            let what = task.outputs.first().map_or("dn", |&output| OUTPUTS[output as usize]);
            return Err(Error::Diverged { sample, time: sample as f64 * run.dt, what });
        }
        if seen + 1 == run.seen() {
            break;
        }
        for step in 0..every {
            ship.step();
            unchecked += 1;
            if unchecked == STEPS_BETWEEN_CHECKS {
                unchecked = 0;
                stop.check()?;
            }
            if let (Some(late), true) = (&mut late, step + 1 < every) {
                late.push(&ship, task.outputs);
            }
        }
    }
    Ok(())
}
