//! Fixed-step integration of the plant.

mod march;
mod method;
mod run;
mod scheme;

use std::marker::PhantomData;

use pulp::{Simd, WithSimd};

use crate::error::{Result, require};
use crate::instruction_set::arch;
use crate::plant::{Envelope, Library, Limit, Power, Square};
use crate::stop::Stop;
pub use march::ROWS;
use march::march;
use method::{Euler, Heun, Method, Rk4};
pub use run::Run;
pub use scheme::{Hold, MethodName, Scheme};

/// Simulate a run into the [`ROWS`] rows of `output`: `n_s` [rev/s], `E_n` [rev], `X_f` [mm], `M_b` [Nm]. Column k is the
/// state at sample k with the set point of sample k already applied.
///
/// # Errors
/// [`Error::Diverged`](crate::error::Error::Diverged) where a result is not finite,
/// [`Error::Stopped`](crate::error::Error::Stopped) on request, [`Error::Invalid`](crate::error::Error::Invalid) for
/// an output of the wrong length.
pub fn simulate(
    run: &Run<'_>,
    envelope: &Envelope,
    scheme: &Scheme,
    output: &mut [f64],
    stop: &Stop,
) -> Result<()> {
    let length = ROWS * run.set_speed.len();
    require(output.len() == length, || format!("output has {} values, expected {length}", output.len()))?;
    match scheme.method {
        MethodName::Euler => by_method::<Euler>(run, envelope, scheme, output, stop),
        MethodName::Heun => by_method::<Heun>(run, envelope, scheme, output, stop),
        MethodName::Rk4 => by_method::<Rk4>(run, envelope, scheme, output, stop),
    }
}

fn by_method<M: Method>(
    run: &Run<'_>,
    envelope: &Envelope,
    scheme: &Scheme,
    output: &mut [f64],
    stop: &Stop,
) -> Result<()> {
    let task = Task { run, scheme, output, stop };
    let square = run.plant.propeller.is_square();
    match (envelope, square) {
        (Envelope::Constant(limit), true) => task.start::<M, Square, _>(*limit),
        (Envelope::Constant(limit), false) => task.start::<M, Library, _>(*limit),
        (Envelope::Table(table), true) => task.start::<M, Square, _>(table.cursor()),
        (Envelope::Table(table), false) => task.start::<M, Library, _>(table.cursor()),
    }
}

/// What a loop works on.
struct Task<'a> {
    run: &'a Run<'a>,
    scheme: &'a Scheme,
    output: &'a mut [f64],
    stop: &'a Stop,
}

impl Task<'_> {
    fn start<M: Method, P: Power, L: Limit>(self, limit: L) -> Result<()> {
        arch().dispatch(Loop { task: self, limit, kind: PhantomData::<(M, P)> })
    }
}

/// The loop for a method, a propeller and a limit, compiled for the machine's instructions.
struct Loop<'a, M, P, L> {
    task: Task<'a>,
    limit: L,
    kind: PhantomData<(M, P)>,
}

impl<M: Method, P: Power, L: Limit> WithSimd for Loop<'_, M, P, L> {
    type Output = Result<()>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> Result<()> {
        let Task { run, scheme, output, stop } = self.task;
        // Wherever there are vectors there are fused multiply-adds.
        if S::F64_LANES > 1 {
            march::<M, P, L, true>(run, self.limit, scheme, output, stop)
        } else {
            march::<M, P, L, false>(run, self.limit, scheme, output, stop)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Error;

    const LAUNCH: [f64; 12] =
        [21.2, 3.0, 0.95, 27.0, -6.0, 0.0, 12.18, 2.0, 13.07, 6.03, 0.603, f64::NEG_INFINITY];

    fn outcome(values: usize, stop: &Stop) -> Result<()> {
        let set_speed = [22.0; 10];
        let run = Run::new(&LAUNCH, &set_speed, &[7.0, 0.0])?;
        let scheme = Scheme::new(0.01, 1, MethodName::Rk4, Hold::Zero)?;
        simulate(&run, &Envelope::new(&[], &[])?, &scheme, &mut vec![0.0; values], stop)
    }

    #[test]
    fn a_run_stops_on_request() {
        let stop = Stop::new();
        assert_eq!(outcome(40, &stop), Ok(()));
        stop.request();
        assert_eq!(outcome(40, &stop), Err(Error::Stopped));
    }

    #[test]
    fn an_output_of_another_length_is_refused() {
        assert!(
            matches!(outcome(39, &Stop::new()), Err(Error::Invalid(message)) if message.contains("39 values, expected 40"))
        );
    }
}
