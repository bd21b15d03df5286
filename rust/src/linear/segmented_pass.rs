//! The pass over the samples: signals of the loop and their derivatives, block by block.
//!
//! A recursion is bound by latency: each step waits for the one before. So a long record is cut into [`LANES`] segments that
//! run side by side, one in each SIMD lane. The model is linear: a first run from rest gives each segment's contribution to its
//! end state, `phi` to the power of the segment's length carries the start states across, and a second run has them right.
//! The cut depends on the record's length alone, so results don't depend on threads.

use std::array::from_fn;
use std::ops::Range;

use super::basis::Basis;
use super::discrete::{LEAP, Model, SHORTEST_NETWORK, delayed, direct};
use super::parameters::Parameters;
pub use super::step_kernel::LANES;
use super::step_kernel::{Advance, Pack, States};
use crate::error::{Error, Result, require};
use crate::finite::all_finite;
use crate::hold::Hold;
use crate::stop::Stop;

/// Steps in a block; its rows then fit into the fastest cache.
const STEPS: usize = 32;
/// Values of one row in a block.
pub const BLOCK: usize = STEPS * LANES;

/// What drives a simulation.
#[derive(Debug, Clone, Copy)]
pub struct Drive<'a> {
    dn_set: &'a [f64],
    dt: f64,
    hold: Hold,
    initial: [f64; 2],
}

impl<'a> Drive<'a> {
    /// Check and collect: set point, sample time in s, hold, initial (dn, dE).
    ///
    /// Before the record the set point stands at its first sample, since a measured record starts in the middle of a signal.
    /// A virtual record that starts at 0, from rest, is the same with either convention.
    ///
    /// # Errors
    /// [`Error::Invalid`](crate::error::Error::Invalid) for an empty set point, one that is not finite, a sample time that is not positive, or an initial
    /// state that is not two finite numbers.
    pub fn new(dn_set: &'a [f64], dt: f64, hold: Hold, initial: &[f64]) -> Result<Self> {
        require(!dn_set.is_empty(), || "dn_set has no samples, expected at least 1".to_owned())?;
        if !all_finite(dn_set) {
            let bad = dn_set.iter().position(|value| !value.is_finite()).unwrap_or_default();
            return Err(Error::Invalid(format!(
                "dn_set[{bad}] is {}, expected a finite number; bridge gaps before",
                dn_set[bad]
            )));
        }
        require(dt.is_finite() && dt > 0.0, || format!("dt is {dt}, expected a positive sample time [s]"))?;
        let start: [f64; 2] = initial.try_into().unwrap_or([f64::NAN; 2]);
        require(start.iter().all(|value| value.is_finite()), || {
            format!("initial is {initial:?}, expected two finite numbers (dn, dE)")
        })?;
        Ok(Self { dn_set, dt, hold, initial: start })
    }

    /// Number of samples.
    #[must_use]
    pub const fn samples(&self) -> usize {
        self.dn_set.len()
    }

    /// Sample time in s.
    #[must_use]
    pub const fn dt(&self) -> f64 {
        self.dt
    }
}

/// A stretch of the pass: `BLOCK` values of every row of the basis, lane after lane within a step.
pub struct Block<'a> {
    rows: &'a mut [f64],
    segment: usize,
    first: usize,
    steps: usize,
}

impl Block<'_> {
    /// All rows, one after the other.
    pub const fn rows(&mut self) -> &mut [f64] {
        self.rows
    }

    /// Where the samples of a lane lie in a series of so many; the last lane's may be cut short.
    fn stretch(&self, lane: usize, samples: usize) -> Range<usize> {
        let start = (lane * self.segment + self.first).min(samples);
        start..(start + self.steps).min(samples)
    }

    /// Lay the values of a row into its part of a series of samples.
    pub fn take(&self, row: &[f64; BLOCK], series: &mut [f64]) {
        for lane in 0..LANES {
            let stretch = self.stretch(lane, series.len());
            for (sample, value) in series[stretch].iter_mut().zip(row[lane..].iter().step_by(LANES)) {
                *sample = *value;
            }
        }
    }
}

/// How a pass is laid out.
#[derive(Debug, Clone, Copy)]
pub enum Layout {
    /// Segments side by side.
    Segments,
    /// One segment in the first lane; the others idle.
    Sequential,
}

/// Simulate, and give each block of the basis' rows to `consume`.
///
/// # Errors
/// What `consume` returns, or [`Error::Stopped`](crate::error::Error::Stopped).
pub fn walk(
    parameters: &Parameters,
    drive: &Drive<'_>,
    basis: &Basis,
    layout: Layout,
    stop: &Stop,
    consume: impl FnMut(Block<'_>) -> Result<()>,
) -> Result<()> {
    let network = parameters.t_d >= SHORTEST_NETWORK * drive.dt || basis.needs_network();
    let segment = match layout {
        Layout::Segments => drive.samples().div_ceil(LANES),
        Layout::Sequential => drive.samples(),
    };
    let Drive { dt, hold, initial, .. } = *drive;
    let directions = &basis.directions;
    let course = Course { dn_set: drive.dn_set, segment, stop };
    if network {
        pass(&delayed(parameters, dt, hold, initial, directions, segment), course, basis, consume)
    } else {
        pass(&direct(parameters, dt, hold, initial, directions, segment), course, basis, consume)
    }
}

/// What a pass runs over: the set point, cut into segments of one length.
#[derive(Clone, Copy)]
struct Course<'a> {
    dn_set: &'a [f64],
    segment: usize,
    stop: &'a Stop,
}

impl Course<'_> {
    /// First step and number of steps of every block of a segment.
    fn blocks(self) -> impl Iterator<Item = (usize, usize)> {
        (0..self.segment).step_by(STEPS).map(move |first| (first, STEPS.min(self.segment - first)))
    }
}

/// A block's samples of each input, lane after lane.
struct Inputs<const J: usize>([Vec<Pack>; J]);

impl<const J: usize> Inputs<J> {
    fn new() -> Self {
        Self(from_fn(|_| vec![[0.0; LANES]; STEPS + 2]))
    }

    /// Fill each input with its samples, delayed by `late`, from one sample before `first` on. Before and after the record its
    /// first and last samples hold.
    fn fill(&mut self, course: Course<'_>, late: &[usize; J], first: usize, steps: usize) {
        let Course { dn_set, segment, .. } = course;
        for (input, &late) in self.0.iter_mut().zip(late) {
            let input = &mut input[..steps + 2];
            if first > late && (LANES - 1) * segment + first - late + steps < dn_set.len() {
                interleave(&from_fn(|lane| &dn_set[lane * segment + first - late - 1..]), input);
            } else {
                for (offset, pack) in input.iter_mut().enumerate() {
                    *pack = from_fn(|lane| {
                        let sample = (lane * segment + first + offset).saturating_sub(late).saturating_sub(1);
                        dn_set[sample.min(dn_set.len() - 1)]
                    });
                }
            }
        }
    }
}

/// Lay series side by side, one in each lane.
#[allow(clippy::needless_range_loop)] // `from_fn` is not inlined here, and costs as much as the simulation
fn interleave<const L: usize>(series: &[&[f64]; L], into: &mut [[f64; L]]) {
    let length = into.len();
    let mut cut = *series;
    for lane in 0..L {
        cut[lane] = &cut[lane][..length];
    }
    for k in 0..length {
        for lane in 0..L {
            into[k][lane] = cut[lane][k];
        }
    }
}

/// `matrix` times the state of one lane.
fn times<const N: usize>(matrix: &[[f64; N]; N], packs: &[Pack; N], lane: usize) -> [f64; N] {
    matrix.map(|row| row.iter().zip(packs).map(|(factor, pack)| factor * pack[lane]).sum())
}

/// States at the end of every segment, each begun from rest.
fn ends<const N: usize, const J: usize>(model: &Model<N, J>, course: Course<'_>) -> Result<States<N>> {
    let mut states = States { x: [[0.0; LANES]; N], by: vec![[[0.0; LANES]; N]; model.stepper.by.len()] };
    let mut inputs = Inputs::new();
    for (first, steps) in course.blocks() {
        course.stop.check()?;
        inputs.fill(course, &model.late, first, steps);
        let (inputs, states) = (&inputs.0, &mut states);
        let (signals, most, rows): (&[usize], usize, &mut [Pack]) = (&[], 0, &mut []);
        if steps % LEAP == 0 {
            let (stepper, steps) = (&model.leaper, steps / LEAP);
            Advance { stepper, inputs, steps, states, signals, most, rows }.run();
        } else {
            Advance { stepper: &model.stepper, inputs, steps, states, signals, most, rows }.run();
        }
    }
    Ok(states)
}

/// States at the start of every segment.
fn starts<const N: usize, const J: usize>(model: &Model<N, J>, course: Course<'_>) -> Result<States<N>> {
    let in_first_lane =
        |start: &[f64; N]| start.map(|value| from_fn(|lane| if lane == 0 { value } else { 0.0 }));
    let mut starts =
        States { x: in_first_lane(&model.start), by: model.start_by.iter().map(in_first_lane).collect() };
    if course.segment == course.dn_set.len() {
        return Ok(starts);
    }
    let ends = ends(model, course)?;
    for lane in 1..LANES {
        let before = lane - 1;
        for (direction, across_by) in model.across_by.iter().enumerate() {
            let from_s = times(&model.across, &starts.by[direction], before);
            let from_x = times(across_by, &starts.x, before);
            for (i, start) in starts.by[direction].iter_mut().enumerate() {
                start[lane] = ends.by[direction][i][before] + from_s[i] + from_x[i];
            }
        }
        let from_x = times(&model.across, &starts.x, before);
        for (i, start) in starts.x.iter_mut().enumerate() {
            start[lane] = ends.x[i][before] + from_x[i];
        }
    }
    Ok(starts)
}

/// Run all lanes through their segments.
fn pass<const N: usize, const J: usize>(
    model: &Model<N, J>,
    course: Course<'_>,
    basis: &Basis,
    mut consume: impl FnMut(Block<'_>) -> Result<()>,
) -> Result<()> {
    let mut states = starts(model, course)?;
    let mut inputs = Inputs::new();
    let mut packs = vec![[0.0; LANES]; basis.rows() * STEPS];
    for (first, steps) in course.blocks() {
        course.stop.check()?;
        inputs.fill(course, &model.late, first, steps);
        Advance {
            stepper: &model.stepper,
            inputs: &inputs.0,
            steps,
            states: &mut states,
            signals: &basis.signals,
            most: STEPS,
            rows: &mut packs,
        }
        .run();
        consume(Block { rows: packs.as_flattened_mut(), segment: course.segment, first, steps })?;
    }
    Ok(())
}
