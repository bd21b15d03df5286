//! The loop over samples, for a group of plants side by side.

use std::marker::PhantomData;

use super::method::{Change, Method};
use super::runs::Runs;
use super::scheme::{Hold, Scheme};
use crate::error::{Error, Result};
use crate::plant::{Limit, Motion, Number, Power, State};
use crate::stop::{CHECK_EVERY, Stop};
use crate::subnormal::cut_all;

/// Rows of an output.
pub const ROWS: usize = 4;
const ROW_NAMES: [&str; ROWS] = ["n_s", "E_n", "X_f", "M_b"];

/// Samples worked on at a time.
const TILE: usize = 128;

/// Runs that march in step.
pub struct Group<'a> {
    pub runs: &'a Runs<'a>,
    /// The first of them.
    pub first: usize,
    pub scheme: &'a Scheme,
    /// [`ROWS`] rows of samples a run.
    pub output: &'a mut [f64],
    pub stop: &'a Stop,
}

impl Group<'_> {
    /// The run in a lane; lanes beyond the last run repeat it and are not written.
    fn run(&self, lane: usize) -> usize {
        (self.first + lane).min(self.runs.len() - 1)
    }

    /// The set points of all lanes from a sample on; the last one stays.
    #[inline(always)]
    fn read<const LANES: usize>(&self, from: usize, tile: &mut [[f64; LANES]]) {
        let last = self.runs.samples - 1;
        if let Some(set_speed) = self.runs.common_set_speed() {
            for (k, sets) in tile.iter_mut().enumerate() {
                *sets = [set_speed[last.min(from + k)]; LANES];
            }
        } else {
            for lane in 0..LANES {
                let set_speed = self.runs.set_speed(self.run(lane));
                for (k, sets) in tile.iter_mut().enumerate() {
                    sets[lane] = set_speed[last.min(from + k)];
                }
            }
        }
    }

    /// Write a row of all lanes from a sample on, each to its own run's output.
    ///
    /// Four lanes at a time: the compiler turns that into shuffles of vectors.
    #[inline(always)]
    fn write<const LANES: usize>(&mut self, row: usize, from: usize, tile: &[[f64; LANES]]) {
        let rows = self.output.chunks_exact_mut(self.runs.samples).skip(row).step_by(ROWS);
        let mut outputs = rows.map(|output| &mut output[from..from + tile.len()]);
        let mut quad = [[0.0; 4]; TILE];
        let quad = &mut quad[..tile.len()];
        for first in (0..LANES).step_by(4) {
            for (quad, lanes) in quad.iter_mut().zip(tile) {
                let lanes = &lanes[first..LANES.min(first + 4)];
                quad[..lanes.len()].copy_from_slice(lanes);
            }
            let four = [outputs.next(), outputs.next(), outputs.next(), outputs.next()];
            if let [Some(a), Some(b), Some(c), Some(d)] = four {
                for (k, quad) in quad.iter().enumerate() {
                    [a[k], b[k], c[k], d[k]] = *quad;
                }
            } else {
                for (lane, output) in four.into_iter().flatten().enumerate() {
                    for (value, quad) in output.iter_mut().zip(&*quad) {
                        *value = quad[lane];
                    }
                }
            }
        }
    }

    /// The first result of a tile that is not finite.
    #[cold]
    fn check(&self, from: usize, count: usize) -> Result<()> {
        let bad = |row: &[f64]| row[from..from + count].iter().position(|value| !value.is_finite());
        let rows = self.output.chunks_exact(self.runs.samples).enumerate();
        let Some((sample, row)) = rows.filter_map(|(row, values)| Some((from + bad(values)?, row))).min()
        else {
            return Ok(());
        };
        let time = sample as f64 * self.scheme.dt;
        let diverged = Error::Diverged { sample, time, what: ROW_NAMES[row % ROWS] };
        let member = self.first + row / ROWS;
        Err(if self.runs.numbered { Error::Member { member, error: Box::new(diverged) } } else { diverged })
    }
}

/// Set points and records of a tile.
#[repr(C, align(64))]
pub struct Tile<const LANES: usize> {
    rows: [[[f64; LANES]; TILE]; ROWS],
    sets: [[f64; LANES]; TILE + 1],
}

/// How a group's lanes advance through a tile.
pub trait Advance<L, const LANES: usize> {
    /// Advance all lanes through so many samples.
    ///
    /// # Errors
    /// [`Error::Stopped`] on request.
    fn advance(
        &self,
        lanes: &mut Lanes<L, LANES>,
        tile: &mut Tile<LANES>,
        count: usize,
        stop: &Stop,
    ) -> Result<()>;
}

/// March the group, of at most `LANES` runs, through all samples.
///
/// A tile of samples is worked out for all runs, then written out run by run. A state that is no longer finite never
/// becomes finite again, so a check at the end of each tile finds every one.
#[inline(always)]
pub fn march<M: Method, L, const LANES: usize>(
    mut group: Group<'_>,
    limit: L,
    advance: &impl Advance<L, LANES>,
) -> Result<()> {
    let (samples, stop) = (group.runs.samples, group.stop);
    let mut lanes = Lanes::<L, LANES>::new::<M>(&group, limit);
    let mut tile = Tile { sets: [[0.0; LANES]; TILE + 1], rows: [[[0.0; LANES]; TILE]; ROWS] };
    let most = (CHECK_EVERY / lanes.substeps.saturating_mul(LANES)).clamp(1, TILE);
    for from in (0..samples).step_by(most) {
        let count = most.min(samples - from);
        group.read(from, &mut tile.sets[..=count]);
        advance.advance(&mut lanes, &mut tile, count, stop)?;
        for (row, records) in tile.rows.iter().enumerate() {
            group.write(row, from, &records[..count]);
        }
        cut_all(&mut lanes.speed);
        cut_all(&mut lanes.error);
        if !lanes.finite() {
            group.check(from, count)?;
        }
        stop.check()?;
    }
    Ok(())
}

/// Runs side by side.
///
/// Aligned, and the lanes first: loading a vector that was stored across two cache lines is slow.
#[repr(C, align(64))]
pub struct Lanes<L, const LANES: usize> {
    speed: [f64; LANES],
    error: [f64; LANES],
    motion: Motion<[f64; LANES]>,
    limit: L,
    substeps: usize,
    /// Part of the interval between two set points that a step covers.
    part: f64,
}

impl<L, const LANES: usize> Lanes<L, LANES> {
    fn new<M: Method>(group: &Group<'_>, limit: L) -> Self {
        let substeps = group.scheme.substeps;
        let duration = group.scheme.dt / substeps as f64 * M::UNIT;
        let motions = std::array::from_fn(|lane| Motion::new(&group.runs.plants[group.run(lane)], duration));
        let states: [State; LANES] =
            std::array::from_fn(|lane| motions[lane].state(group.runs.initial[group.run(lane)]));
        Self {
            speed: states.map(|state| state.speed),
            error: states.map(|state| state.error),
            motion: Motion::beside(&motions),
            limit,
            substeps,
            part: match group.scheme.hold {
                Hold::Zero => 0.0,
                Hold::First => 1.0 / substeps as f64,
            },
        }
    }

    /// Advance the lanes of one register through the samples of a tile; their states stay in registers.
    #[inline(always)]
    pub fn advance<T: Number, M: Method, P: Power, const FUSED: bool>(
        &mut self,
        tile: &mut Tile<LANES>,
        count: usize,
        stop: &Stop,
        place: T::Place,
    ) -> Result<()>
    where
        L: Limit,
    {
        let mut state = State { speed: T::load(place, &self.speed), error: T::load(place, &self.error) };
        let motion = self.motion.load::<T>(place);
        for k in 0..count {
            let start = T::load(place, &tile.sets[k]);
            let slope = (T::load(place, &tile.sets[k + 1]) - start) * start.like(self.part);
            for substep in 0..self.substeps {
                let set = slope.times_plus::<FUSED>(start.like(substep as f64), start);
                let push = motion.push::<FUSED>(&mut self.limit, set, state);
                if substep == 0 {
                    let record = motion.record::<FUSED>(push, set, state);
                    for (row, record) in tile.rows.iter_mut().zip(record) {
                        record.store(place, &mut row[k]);
                    }
                } else if substep % CHECK_EVERY == 0 {
                    stop.check()?;
                }
                let first = motion.change::<P, FUSED>(push, set, state);
                let mut step =
                    Step { motion: &motion, limit: &mut self.limit, set, slope, power: PhantomData::<P> };
                state = M::advance::<T, FUSED>(state, first, &mut step);
            }
        }
        state.speed.store(place, &mut self.speed);
        state.error.store(place, &mut self.error);
        Ok(())
    }

    fn finite(&self) -> bool {
        self.speed.iter().chain(&self.error).all(|value| value.is_finite())
    }
}

/// A step under a set point that moves evenly.
struct Step<'a, T, L, P> {
    motion: &'a Motion<T>,
    limit: &'a mut L,
    set: T,
    slope: T,
    power: PhantomData<P>,
}

impl<T: Number, L: Limit, P: Power> Change<T> for Step<'_, T, L, P> {
    #[inline(always)]
    fn over<const FUSED: bool>(&mut self, passed: f64, state: State<T>) -> State<T> {
        let set = self.slope.times_plus::<FUSED>(self.set.like(passed), self.set);
        self.motion.change::<P, FUSED>(self.motion.push::<FUSED>(self.limit, set, state), set, state)
    }
}
