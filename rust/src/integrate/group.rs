//! The loop over samples, for a group of plants side by side.

use super::method::Method;
use super::runs::Runs;
use super::scheme::{Hold, Scheme};
use crate::error::{Error, Result};
use crate::plant::{Limit, Motion, Power, State};
use crate::stop::{CHECK_EVERY, Stop};

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

/// March the group, of at most `LANES` runs, through all samples.
///
/// A tile of samples is worked on at a time, the lanes innermost so that they vectorise, and then written out run by
/// run. A state that is not finite stays so: looking for it once a tile misses none.
#[inline(always)]
pub fn march<M: Method, P: Power, L: Limit, const LANES: usize>(
    mut group: Group<'_>,
    limit: L,
) -> Result<()> {
    let samples = group.runs.samples;
    let substeps = group.scheme.substeps;
    let mut lanes = Lanes::<L, LANES>::new(&group, group.scheme.dt / substeps as f64 * M::UNIT, limit);
    let mut sets = [[0.0; LANES]; TILE + 1];
    let mut rows = [[[0.0; LANES]; TILE]; ROWS];
    let tile = (CHECK_EVERY / substeps.saturating_mul(LANES)).clamp(1, TILE);
    for from in (0..samples).step_by(tile) {
        let count = tile.min(samples - from);
        group.read(from, &mut sets[..=count]);
        for k in 0..count {
            let record = lanes.advance::<M, P>(&sets[k], &sets[k + 1], 0);
            for (row, record) in rows.iter_mut().zip(record) {
                row[k] = record;
            }
            for substep in 1..substeps {
                if substep % CHECK_EVERY == 0 {
                    group.stop.check()?;
                }
                lanes.advance::<M, P>(&sets[k], &sets[k + 1], substep);
            }
        }
        for (row, tile) in rows.iter().enumerate() {
            group.write(row, from, &tile[..count]);
        }
        if !lanes.finite() {
            group.check(from, count)?;
        }
        group.stop.check()?;
    }
    Ok(())
}

/// Runs side by side.
struct Lanes<L, const LANES: usize> {
    motion: Motion<[f64; LANES]>,
    limit: L,
    speed: [f64; LANES],
    error: [f64; LANES],
    /// Part of the way between set points that a step covers.
    part: f64,
}

impl<L: Limit, const LANES: usize> Lanes<L, LANES> {
    fn new(group: &Group<'_>, duration: f64, limit: L) -> Self {
        let motions = std::array::from_fn(|lane| Motion::new(&group.runs.plants[group.run(lane)], duration));
        let states: [State; LANES] =
            std::array::from_fn(|lane| motions[lane].state(group.runs.initial[group.run(lane)]));
        Self {
            motion: Motion::beside(&motions),
            limit,
            speed: states.map(|state| state.speed),
            error: states.map(|state| state.error),
            part: match group.scheme.hold {
                Hold::Zero => 0.0,
                Hold::First => 1.0 / group.scheme.substeps as f64,
            },
        }
    }

    /// Take a step from the start of a substep between two set points, and return the records of that start.
    #[inline(always)]
    fn advance<M: Method, P: Power>(
        &mut self,
        sets: &[f64; LANES],
        next_sets: &[f64; LANES],
        substep: usize,
    ) -> [[f64; LANES]; ROWS] {
        let mut records = [[0.0; LANES]; ROWS];
        let passed = substep as f64;
        for lane in 0..LANES {
            let motion = self.motion.lane(lane);
            let state = State { speed: self.speed[lane], error: self.error[lane] };
            let slope = (next_sets[lane] - sets[lane]) * self.part;
            let set = sets[lane] + slope * passed;
            let push = motion.push(&mut self.limit, set, state);
            let record = motion.record(push, set, state);
            for row in 0..ROWS {
                records[row][lane] = record[row];
            }
            let first = motion.change::<P>(push, set, state);
            let next = M::advance(state, first, |passed, state| {
                let set = set + slope * passed;
                motion.change::<P>(motion.push(&mut self.limit, set, state), set, state)
            });
            self.speed[lane] = next.speed;
            self.error[lane] = next.error;
        }
        records
    }

    fn finite(&self) -> bool {
        self.speed.iter().chain(&self.error).all(|value| value.is_finite())
    }
}
