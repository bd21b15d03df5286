//! Fixed-step integration of the plant: one run, or many side by side.

mod group;
mod method;
mod runs;
mod scheme;

use std::marker::PhantomData;

use pulp::{Simd, WithSimd};
use rayon::prelude::*;

use crate::error::{Result, require};
use crate::instruction_set::arch;
use crate::plant::{Envelope, Library, Limit, Polynomial, Power, Registers, Square};
use crate::pool::on_threads;
use crate::stop::Stop;
pub use group::ROWS;
use group::{Advance, Group, Lanes, Tile, march};
use method::{Euler, Heun, Method, Rk4};
pub use runs::{Rows, Runs};
pub use scheme::{Hold, MethodName, Scheme};

/// Runs side by side: two vectors of AVX-512.
const LANES: usize = 16;
/// Vectors whose operations take turns.
const REGISTERS: usize = 2;

/// Simulate all runs on so many threads, 0 for all cores; the same bits for any number.
///
/// Each run has [`ROWS`] rows in `output`: `n_s` [rev/s], `E_n` [rev], `X_f` [mm], `M_b` [Nm]. Column k is the state at
/// sample k with the set point of sample k already applied.
///
/// # Errors
/// [`Error::Diverged`](crate::error::Error::Diverged) where a result is not finite, of the first run that has one,
/// [`Error::Stopped`](crate::error::Error::Stopped) on request, [`Error::Invalid`](crate::error::Error::Invalid) for
/// an output of the wrong length.
pub fn simulate(
    runs: &Runs<'_>,
    envelope: &Envelope,
    scheme: &Scheme,
    threads: usize,
    output: &mut [f64],
    stop: &Stop,
) -> Result<()> {
    let length = runs.len() * ROWS * runs.samples;
    require(output.len() == length, || format!("output has {} values, expected {length}", output.len()))?;
    let square = runs.plants.iter().all(|plant| plant.propeller.is_square());
    let run = match scheme.method {
        MethodName::Euler => choose::<Euler>(runs.len(), square),
        MethodName::Heun => choose::<Heun>(runs.len(), square),
        MethodName::Rk4 => choose::<Rk4>(runs.len(), square),
    };
    let march = |(first, output)| run(envelope, Group { runs, first: LANES * first, scheme, output, stop });
    let size = LANES * ROWS * runs.samples;
    let groups = runs.len().div_ceil(LANES);
    if threads == 1 || groups <= 1 {
        return output.chunks_mut(size).enumerate().try_for_each(march);
    }
    let outcomes: Vec<_> =
        on_threads(threads.min(groups), || Ok(output.par_chunks_mut(size).enumerate().map(march).collect()))?;
    outcomes.into_iter().collect()
}

/// The loop compiled for a method, a number of runs and a propeller.
fn choose<M: Method>(runs: usize, square: bool) -> fn(&Envelope, Group<'_>) -> Result<()> {
    match (runs, square) {
        (1, true) => alone::<M, Square>,
        (1, false) => alone::<M, Library>,
        (_, true) => abreast::<M, Square>,
        (_, false) => abreast::<M, Polynomial>,
    }
}

fn alone<M: Method, P: Power>(envelope: &Envelope, group: Group<'_>) -> Result<()> {
    match envelope {
        Envelope::Constant(limit) => march_alone::<M, P, _>(group, *limit),
        Envelope::Table(table) => march_alone::<M, P, _>(group, table.cursor()),
    }
}

fn march_abreast<M: Method, P: Power, L: Limit>(group: Group<'_>, limit: L) -> Result<()> {
    arch().dispatch(Abreast { group, limit, kind: PhantomData::<(M, P)> })
}

fn abreast<M: Method, P: Power>(envelope: &Envelope, group: Group<'_>) -> Result<()> {
    match envelope {
        Envelope::Constant(limit) => march_abreast::<M, P, _>(group, *limit),
        Envelope::Table(table) => match table.hinges::<8>() {
            Some(limit) => march_abreast::<M, P, _>(group, limit),
            None => march_abreast::<M, P, _>(group, table.cursor()),
        },
    }
}

fn march_alone<M: Method, P: Power, L: Limit>(group: Group<'_>, limit: L) -> Result<()> {
    arch().dispatch(One { group, limit, kind: PhantomData::<(M, P)> })
}

/// One run by itself, compiled for the machine's instructions.
struct One<'a, M, P, L> {
    group: Group<'a>,
    limit: L,
    kind: PhantomData<(M, P)>,
}

impl<M: Method, P: Power, L: Limit> WithSimd for One<'_, M, P, L> {
    type Output = Result<()>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> Result<()> {
        // Wherever there are vectors there are fused multiply-adds.
        if S::F64_LANES > 1 {
            march::<M, L, 1>(self.group, self.limit, &Alone::<M, P, true>(PhantomData))
        } else {
            march::<M, L, 1>(self.group, self.limit, &Alone::<M, P, false>(PhantomData))
        }
    }
}

/// How one run advances through a tile.
struct Alone<M, P, const FUSED: bool>(PhantomData<(M, P)>);

impl<M: Method, P: Power, L: Limit, const FUSED: bool> Advance<L, 1> for Alone<M, P, FUSED> {
    #[inline(always)]
    fn advance(&self, lanes: &mut Lanes<L, 1>, tile: &mut Tile<1>, count: usize, stop: &Stop) -> Result<()> {
        lanes.advance::<f64, M, P, FUSED>(tile, count, stop, ())
    }
}

/// Runs side by side, with the widest vectors that the machine has.
struct Abreast<'a, M, P, L> {
    group: Group<'a>,
    limit: L,
    kind: PhantomData<(M, P)>,
}

impl<M: Method, P: Power, L: Limit> WithSimd for Abreast<'_, M, P, L> {
    type Output = Result<()>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Result<()> {
        march::<M, L, LANES>(self.group, self.limit, &Vectors::<S, M, P> { simd, kind: PhantomData })
    }
}

/// Vectors of a kind.
struct Vectors<S, M, P> {
    simd: S,
    kind: PhantomData<(M, P)>,
}

impl<S: Simd, M: Method, P: Power, L: Limit> Advance<L, LANES> for Vectors<S, M, P> {
    #[inline(always)]
    fn advance(
        &self,
        lanes: &mut Lanes<L, LANES>,
        tile: &mut Tile<LANES>,
        count: usize,
        stop: &Stop,
    ) -> Result<()> {
        for first in (0..LANES / S::F64_LANES).step_by(REGISTERS) {
            let place = (self.simd, first);
            // Wherever there are vectors there are fused multiply-adds.
            if S::F64_LANES > 1 {
                lanes.advance::<Registers<S, REGISTERS>, M, P, true>(tile, count, stop, place)?;
            } else {
                lanes.advance::<Registers<S, REGISTERS>, M, P, false>(tile, count, stop, place)?;
            }
        }
        Ok(())
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
        let runs = Runs::one(&LAUNCH, &set_speed, &[7.0, 0.0])?;
        let scheme = Scheme::new(0.01, 1, MethodName::Rk4, Hold::Zero)?;
        simulate(&runs, &Envelope::new(&[], &[])?, &scheme, 1, &mut vec![0.0; values], stop)
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
