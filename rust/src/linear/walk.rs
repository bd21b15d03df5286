//! The pass over the samples: signals of the loop and their derivatives, block by block.
//!
//! A recursion is bound by latency: each step waits for the one before. So a long record is cut into [`LANES`] segments that
//! run side by side, one in each SIMD lane. The model is linear: a first run from rest gives each segment's contribution to its
//! end state, `phi` to the power of the segment's length carries the start states across, and a second run has them right.
//! The cut depends on the record's length alone, so results don't depend on threads.

use std::array::from_fn;

use multiversion::multiversion;
use multiversion::target::match_target;

use super::basis::{Basis, E, N as SPEED, SLOPE};
use super::discrete::{DELAYED, DIRECT, Model, SHORTEST_NETWORK, delayed, direct};
use super::parameters::Parameters;
use crate::error::{Result, require};
use crate::integrate::Hold;
use crate::stop::{CHECK_EVERY, Stop};

/// Segments that run side by side.
const LANES: usize = 8;
/// Records shorter than this run as one segment.
const LONG: usize = 64 * LANES;
/// Values of one row in a block: `BLOCK / lanes` steps of each lane. Rows of a block then fit into the fastest cache.
pub const BLOCK: usize = 256;

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
        if let Some(bad) = dn_set.iter().position(|value| !value.is_finite()) {
            require(false, || {
                format!("dn_set[{bad}] is {}, expected a finite number; bridge gaps before", dn_set[bad])
            })?;
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
    lanes: usize,
    segment: usize,
    first: usize,
    steps: usize,
}

impl Block<'_> {
    /// All rows, one after the other.
    pub fn rows(&mut self) -> &mut [f64] {
        self.rows
    }

    /// For each lane its number, the sample it starts at and how many samples of a record it holds.
    pub fn lanes(&self, samples: usize) -> impl Iterator<Item = (usize, usize, usize)> + Clone + use<> {
        let (segment, first, steps) = (self.segment, self.first, self.steps);
        (0..self.lanes).map(move |lane| {
            let start = lane * segment + first;
            (lane, start, steps.min(samples.saturating_sub(start)))
        })
    }

    /// How far apart a lane's values are in a row.
    pub const fn stride(&self) -> usize {
        self.lanes
    }
}

/// How a pass is laid out.
#[derive(Debug, Clone, Copy)]
pub enum Layout {
    /// Cut long records into segments.
    Segments,
    /// One segment, as the samples come.
    Sequential,
}

/// Simulate, and give each block of the basis' rows to `consume`, behind `spare` rows for its own use.
///
/// A block has at least three rows more than that, of zeros.
///
/// # Errors
/// What `consume` returns, or [`Error::Stopped`](crate::error::Error::Stopped).
pub fn walk(
    parameters: &Parameters,
    drive: &Drive<'_>,
    basis: &Basis,
    layout: Layout,
    spare: usize,
    stop: &Stop,
    consume: impl FnMut(Block<'_>) -> Result<()>,
) -> Result<()> {
    let network = parameters.t_d >= SHORTEST_NETWORK * drive.dt || basis.needs_network();
    let long = matches!(layout, Layout::Segments) && drive.samples() >= LONG;
    let segment = if long { drive.samples().div_ceil(LANES) } else { drive.samples() };
    let Drive { dt, hold, initial, .. } = *drive;
    let directions = &basis.directions;
    let course = Course { dn_set: drive.dn_set, segment, stop };
    if network {
        let model = delayed(parameters, dt, hold, initial, directions, segment);
        if long {
            pass::<DELAYED, 2, LANES>(&model, course, basis, spare, consume)
        } else {
            pass::<DELAYED, 2, 1>(&model, course, basis, spare, consume)
        }
    } else {
        let model = direct(parameters, dt, hold, initial, directions, segment);
        if long {
            pass::<DIRECT, 1, LANES>(&model, course, basis, spare, consume)
        } else {
            pass::<DIRECT, 1, 1>(&model, course, basis, spare, consume)
        }
    }
}

/// What a pass runs over: the set point, cut into segments of one length.
#[derive(Clone, Copy)]
struct Course<'a> {
    dn_set: &'a [f64],
    segment: usize,
    stop: &'a Stop,
}

/// One number of each lane.
type Pack<const L: usize> = [f64; L];

/// States of all lanes, and their derivatives.
#[derive(Clone)]
struct States<const N: usize, const L: usize> {
    x: [Pack<L>; N],
    by: Vec<[Pack<L>; N]>,
}

/// `matrix` times the state of one lane.
fn times<const N: usize, const L: usize>(
    matrix: &[[f64; N]; N],
    packs: &[Pack<L>; N],
    lane: usize,
) -> [f64; N] {
    matrix.map(|row| row.iter().zip(packs).map(|(factor, pack)| factor * pack[lane]).sum())
}

/// States at the start of every segment.
fn starts<const N: usize, const J: usize, const L: usize>(
    model: &Model<N, J>,
    course: Course<'_>,
) -> Result<States<N, L>> {
    let in_first_lane =
        |start: &[f64; N]| start.map(|value| from_fn(|lane| if lane == 0 { value } else { 0.0 }));
    let mut starts = States {
        x: in_first_lane(&model.step.start),
        by: model.by.iter().map(|by| in_first_lane(&by.start)).collect(),
    };
    if L == 1 {
        return Ok(starts);
    }
    let mut ends = States { x: [[0.0; L]; N], by: vec![[[0.0; L]; N]; model.by.len()] };
    run(model, course, &[], 0, &mut ends, |_, _, _| Ok(()))?;
    for lane in 1..L {
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

fn pass<const N: usize, const J: usize, const L: usize>(
    model: &Model<N, J>,
    course: Course<'_>,
    basis: &Basis,
    spare: usize,
    mut consume: impl FnMut(Block<'_>) -> Result<()>,
) -> Result<()> {
    let mut states = starts::<N, J, L>(model, course)?;
    run(model, course, &basis.signals, spare, &mut states, |rows, first, steps| {
        consume(Block { rows, lanes: L, segment: course.segment, first, steps })
    })
}

/// Run all lanes through their segments.
fn run<const N: usize, const J: usize, const L: usize>(
    model: &Model<N, J>,
    course: Course<'_>,
    signals: &[usize],
    spare: usize,
    states: &mut States<N, L>,
    mut consume: impl FnMut(&mut [f64], usize, usize) -> Result<()>,
) -> Result<()> {
    let Course { dn_set, segment, stop } = course;
    let most = BLOCK / L;
    let mut inputs: [Vec<Pack<L>>; J] = from_fn(|_| vec![[0.0; L]; most + 2]);
    let mut rows = vec![[0.0; L]; (spare + signals.len() * (1 + model.by.len()) + 3) * most];
    for first in (0..segment).step_by(most) {
        if (first * L) % CHECK_EVERY < BLOCK {
            stop.check()?;
        }
        let steps = most.min(segment - first);
        for (input, &late) in inputs.iter_mut().zip(&model.late) {
            for lane in 0..L {
                let from = lane * segment + first;
                gather(dn_set, from, late, lane, &mut input[..steps + 2]);
            }
        }
        advance(model, &inputs, steps, signals, states, &mut rows[spare * most..]);
        consume(rows.as_flattened_mut(), first, steps)?;
    }
    Ok(())
}

/// Lay the samples `from - late - 1` on of the set point into one lane; outside the record its ends hold.
fn gather<const L: usize>(dn_set: &[f64], from: usize, late: usize, lane: usize, into: &mut [Pack<L>]) {
    let last = dn_set.len() - 1;
    let begin = from.saturating_sub(late).wrapping_sub(1);
    if from > late && begin + into.len() <= dn_set.len() {
        for (pack, &value) in into.iter_mut().zip(&dn_set[begin..]) {
            pack[lane] = value;
        }
    } else {
        for (offset, pack) in into.iter_mut().enumerate() {
            pack[lane] = dn_set[(from + offset).saturating_sub(late).saturating_sub(1).min(last)];
        }
    }
}

/// Advance all lanes by `steps` and lay down the rows, if any are wanted.
#[multiversion(targets("x86_64+avx512f+avx512vl+fma", "x86_64+avx2+fma"))]
fn advance<const N: usize, const J: usize, const L: usize>(
    model: &Model<N, J>,
    inputs: &[Vec<Pack<L>>; J],
    steps: usize,
    signals: &[usize],
    states: &mut States<N, L>,
    rows: &mut [Pack<L>],
) {
    match_target! {
        "x86_64+fma" => advance_with::<N, J, L, true>(model, inputs, steps, signals, states, rows),
        "aarch64" => advance_with::<N, J, L, true>(model, inputs, steps, signals, states, rows),
        _ => advance_with::<N, J, L, false>(model, inputs, steps, signals, states, rows),
    }
}

// From here on plain indices: iterators that the compiler does not inline would not be compiled for the machine's features.

/// `sum` plus the packs times their factors, fused where the machine can.
#[inline(always)]
#[allow(clippy::needless_range_loop)]
fn add_products<const K: usize, const L: usize, const FUSED: bool>(
    mut sum: Pack<L>,
    factors: &[f64; K],
    packs: &[Pack<L>; K],
) -> Pack<L> {
    for i in 0..K {
        for lane in 0..L {
            sum[lane] = if FUSED {
                factors[i].mul_add(packs[i][lane], sum[lane])
            } else {
                sum[lane] + factors[i] * packs[i][lane]
            };
        }
    }
    sum
}

/// What the inputs feed through those taps.
#[inline(always)]
fn feed<const J: usize, const L: usize, const FUSED: bool>(
    taps: &[[f64; 3]; J],
    rho: &[[Pack<L>; 3]; J],
) -> Pack<L> {
    let mut sum = [0.0; L];
    for j in 0..J {
        sum = add_products::<3, L, FUSED>(sum, &taps[j], &rho[j]);
    }
    sum
}

#[inline(always)]
#[allow(clippy::needless_range_loop)]
fn advance_with<const N: usize, const J: usize, const L: usize, const FUSED: bool>(
    model: &Model<N, J>,
    inputs: &[Vec<Pack<L>>; J],
    steps: usize,
    signals: &[usize],
    states: &mut States<N, L>,
    rows: &mut [Pack<L>],
) {
    let most = BLOCK / L;
    let step = &model.step;
    let mut x = states.x;
    for k in 0..steps {
        let mut rho = [[[0.0; L]; 3]; J];
        for j in 0..J {
            for tap in 0..3 {
                rho[j][tap] = inputs[j][k + tap];
            }
        }
        for position in 0..signals.len() {
            rows[position * most + k] = match signals[position] {
                SPEED => x[0],
                E => x[1],
                SLOPE => {
                    add_products::<N, L, FUSED>(feed::<J, L, FUSED>(&step.slope_feed, &rho), &step.slope, &x)
                }
                _ => add_products::<3, L, FUSED>([0.0; L], &step.set_feed, &rho[0]),
            };
        }
        for direction in 0..model.by.len() {
            let by = &model.by[direction];
            let s = states.by[direction];
            for position in 0..signals.len() {
                rows[((1 + direction) * signals.len() + position) * most + k] = match signals[position] {
                    SPEED => s[0],
                    E => s[1],
                    SLOPE => {
                        let fed = feed::<J, L, FUSED>(&by.slope_feed, &rho);
                        let from_x = add_products::<N, L, FUSED>(fed, &by.slope, &x);
                        add_products::<N, L, FUSED>(from_x, &step.slope, &s)
                    }
                    _ => add_products::<3, L, FUSED>([0.0; L], &by.set_feed, &rho[0]),
                };
            }
            let next = &mut states.by[direction];
            for i in 0..N {
                let fed = feed::<J, L, FUSED>(&by.taps[i], &rho);
                let from_x = add_products::<N, L, FUSED>(fed, &by.phi[i], &x);
                next[i] = add_products::<N, L, FUSED>(from_x, &step.phi[i], &s);
            }
        }
        let before = x;
        for i in 0..N {
            let fed = feed::<J, L, FUSED>(&step.taps[i], &rho);
            x[i] = add_products::<N, L, FUSED>(fed, &step.phi[i], &before);
        }
    }
    states.x = x;
}
