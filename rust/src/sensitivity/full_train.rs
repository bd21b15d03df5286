//! The whole drive train with numbers that carry their derivatives, in blocks of samples.

use pulp::{Simd, WithSimd};

use crate::drive_train::{self, Run};
use crate::error::Result;
use crate::instruction_set::arch;
use crate::plant::{Constant, Cursor, Envelope, Limit, Slope};
use crate::scalar::{Dual, Tangent};
use crate::stop::Stop;

use super::output::{Consume, Output, require_finite};
use super::parameters::Subject;

/// As [`super::pass::march`], with every element.
pub fn through_whole<const N: usize>(
    subject: &Subject,
    run: &Run<'_>,
    outputs: &[Output],
    block: usize,
    stop: &Stop,
    consume: &mut Consume<'_, N>,
) -> Result<()> {
    run.check_steps(&subject.whole()?)?;
    arch().dispatch(Through { subject, run, outputs, block, stop, consume })
}

struct Through<'a, 'c, const N: usize> {
    subject: &'a Subject,
    run: &'a Run<'a>,
    outputs: &'a [Output],
    block: usize,
    stop: &'a Stop,
    consume: &'a mut Consume<'c, N>,
}

impl<const N: usize> WithSimd for Through<'_, '_, N> {
    type Output = Result<()>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Result<()> {
        let Self { subject, run, outputs, block, stop, consume } = self;
        let train = subject.drive_train::<S, N>(simd);
        let samples = run.set_speed.len();
        let mut rows = vec![Tangent { value: 0.0, slopes: [0.0; N] }; block * outputs.len()];
        let record = |sample: usize, row: &[Dual<S, N>; drive_train::ROWS]| {
            let place = sample % block;
            for (number, output) in rows[place * outputs.len()..].iter_mut().zip(outputs) {
                *number = row[output.row()].tangent();
            }
            if place + 1 < block && sample + 1 < samples {
                return Ok(());
            }
            let (from, rows) = (sample - place, &rows[..(place + 1) * outputs.len()]);
            require_finite(from, rows, outputs, run.dt)?;
            consume(from, rows)
        };
        drive_train::March::new(&train, Either::of(&subject.envelope), run).through(record, stop)
    }
}

/// Both kinds of envelopes in one, so that the equations are compiled once.
enum Either<'a> {
    Constant(Constant),
    Table(Cursor<'a>),
}

impl<'a> Either<'a> {
    fn of(envelope: &'a Envelope) -> Self {
        match envelope {
            Envelope::Constant(limit) => Self::Constant(*limit),
            Envelope::Table(table) => Self::Table(table.cursor()),
        }
    }
}

impl Limit for Either<'_> {
    #[inline(always)]
    fn torque(&mut self, engine_speed: f64) -> f64 {
        match self {
            Self::Constant(limit) => limit.torque(engine_speed),
            Self::Table(cursor) => cursor.torque(engine_speed),
        }
    }
}

impl Slope for Either<'_> {
    #[inline(always)]
    fn slope(&self) -> f64 {
        match self {
            Self::Constant(limit) => limit.slope(),
            Self::Table(cursor) => cursor.slope(),
        }
    }
}
