//! Linear recursions with derivatives: a linear model from one sample to the next.
//!
//! ```text
//! x[k+1] = F x[k] + G w[k]      y[k] = C x[k] + D w[k]
//! ```
//!
//! with inputs w that are copies of one signal, each shifted by whole samples. Differentiated:
//! `dx[k+1] = F dx[k] + dF x[k] + dG w[k]`, `dy[k] = C dx[k] + dC x[k] + dD w[k]`.

use pulp::{Simd, WithSimd};

use crate::error::{Error, Result, require};
use crate::finite::all_finite;
use crate::instruction_set::arch;
use crate::stop::Stop;
use crate::subnormal::cut_all;

/// Samples between two checks for a stop or for divergence, and between cuts of decayed states.
const BLOCK: usize = 64;
/// Number of lanes that a pass computes in parallel: the value and several derivatives.
const LANES: usize = 8;
/// Rows whose sums are interleaved to hide latency.
const GROUP: usize = 5;

/// A validated recursion, with derivatives and input.
#[derive(Debug, Clone, Copy)]
pub struct Recursion<'a> {
    /// `[F, G; C, D]` by rows, then its derivatives.
    system: &'a [f64],
    /// The states at the first sample, then their derivatives.
    start: &'a [f64],
    states: usize,
    outputs: usize,
    signal: &'a [f64],
    shifts: &'a [i64],
    dt: f64,
}

impl<'a> Recursion<'a> {
    /// Validate `system` `[1 + directions, states + outputs, states + inputs]` and `start` `[1 + directions, states]`.
    /// Input `j` of sample `k` is sample `k + shifts[j]` of the signal, which is extended by its first and last samples.
    ///
    /// # Errors
    /// [`Error::Invalid`] if lengths do not match or a value is not finite.
    pub fn new(
        system: &'a [f64],
        start: &'a [f64],
        [states, outputs]: [usize; 2],
        signal: &'a [f64],
        shifts: &'a [i64],
        dt: f64,
    ) -> Result<Self> {
        require(states > 0 && outputs > 0 && !signal.is_empty(), || {
            format!(
                "found {states} states, {outputs} outputs and {} samples, expected at least one of each",
                signal.len()
            )
        })?;
        let each = (states + outputs) * (states + shifts.len());
        require(start.len() >= states && start.len() * each == system.len() * states, || {
            format!("system has {} values and start {}, which do not fit together", system.len(), start.len())
        })?;
        for (name, values) in [("system", system), ("start", start), ("signal", signal)] {
            require(all_finite(values), || {
                format!("{name} holds what is not finite, expected finite numbers; bridge gaps before")
            })?;
        }
        require(dt.is_finite() && dt > 0.0, || format!("dt is {dt}, expected a positive sample time [s]"))?;
        Ok(Self { system, start, states, outputs, signal, shifts, dt })
    }

    /// Run over the signal; fills `values` `[outputs, samples]` and `derivatives` `[directions, outputs, samples]` by rows.
    ///
    /// # Errors
    /// [`Error::Diverged`] where an output or derivative is not finite, [`Error::Stopped`] on request.
    pub fn run(&self, values: &mut [f64], derivatives: &mut [f64], stop: &Stop) -> Result<()> {
        let mut rows: Vec<_> = derivatives.chunks_exact_mut(values.len()).collect();
        if rows.is_empty() {
            return self.pass(0, &mut [values], stop);
        }
        // Each group of directions recomputes the value.
        for (index, some) in rows.chunks_mut(LANES - 1).enumerate() {
            let mut lanes = vec![&mut *values];
            lanes.extend(some.iter_mut().map(|row| &mut **row));
            self.pass(index * (LANES - 1), &mut lanes, stop)?;
        }
        Ok(())
    }

    /// Arrays of a pass that uses `used` lanes.
    fn prepared(&self, skipped: usize, used: usize) -> Steps {
        let Self { system, start, states, outputs, shifts, .. } = *self;
        let (width, rows) = (states + shifts.len(), states + outputs);
        let gather = |values: &[f64], each: usize, at: usize| -> [f64; LANES] {
            std::array::from_fn(|lane| match lane {
                0 => values[at],
                _ if lane < used => values[(skipped + lane) * each + at],
                _ => 0.0,
            })
        };
        let height = rows.next_multiple_of(GROUP);
        let places: Vec<_> = (0..height / GROUP)
            .flat_map(|group| (0..width).map(move |column| (group * GROUP, column)))
            .collect();
        let mut steps = Steps {
            own: places
                .iter()
                .map(|&(row, column)| {
                    std::array::from_fn(
                        |i| if row + i < rows { system[(row + i) * width + column] } else { 0.0 },
                    )
                })
                .collect(),
            fed: places
                .iter()
                .map(|&(row, column)| {
                    std::array::from_fn(|i| {
                        if row + i >= rows {
                            return [0.0; LANES];
                        }
                        let mut lanes = gather(system, rows * width, (row + i) * width + column);
                        if column < states {
                            lanes[0] = 0.0;
                        }
                        lanes
                    })
                })
                .collect(),
            moved: 0,
            states,
            height,
            history: vec![[0.0; LANES]; (BLOCK + 1) * height],
            drive: vec![0.0; BLOCK * shifts.len()],
        };
        // If all derivatives are by the initial state, the system has none, and only the inputs contribute.
        let still = |(place, lanes): (usize, &[[f64; LANES]; GROUP])| {
            place % width >= states || lanes.as_flattened().iter().all(|factor| *factor == 0.0)
        };
        if steps.fed.iter().enumerate().all(still) {
            steps.moved = states;
        }
        for (at, state) in steps.history[..states].iter_mut().enumerate() {
            *state = gather(start, states, at);
        }
        steps
    }

    /// A pass with the value in the first lane and, in the others, the derivatives after `skipped`.
    fn pass(&self, skipped: usize, lanes: &mut [&mut [f64]], stop: &Stop) -> Result<()> {
        let Self { states, signal, shifts, dt, .. } = *self;
        let samples = signal.len();
        let mut steps = self.prepared(skipped, lanes.len());
        let height = steps.height;
        for from in (0..samples).step_by(BLOCK) {
            let to = (from + BLOCK).min(samples);
            for (drive, &shift) in steps.drive.chunks_exact_mut(BLOCK).zip(shifts) {
                let shift = isize::try_from(shift).unwrap_or_default();
                let at = |k: usize| k.saturating_add_signed(shift).min(samples - 1);
                for (value, k) in drive.iter_mut().zip(from..to) {
                    *value = signal[at(k)];
                }
            }
            arch().dispatch(Block { steps: &mut steps, samples: to - from });
            for (lane, series) in lanes.iter_mut().enumerate() {
                for (output, row) in series.chunks_exact_mut(samples).enumerate() {
                    let results = steps.history[height..].chunks_exact(height);
                    let results = results.map(|sums| sums[states + output][lane]);
                    for (value, result) in row[from..to].iter_mut().zip(results) {
                        *value = result;
                    }
                    if !all_finite(&row[from..to]) {
                        let bad = row[from..to].iter().position(|value| !value.is_finite());
                        let sample = from + bad.unwrap_or_default();
                        let what = if lane == 0 { "an output" } else { "a sensitivity" };
                        return Err(Error::Diverged { sample, time: sample as f64 * dt, what });
                    }
                }
            }
            steps.history.copy_within((to - from) * height..(to - from + 1) * height, 0);
            cut_all(steps.history[..states].as_flattened_mut());
            stop.check()?;
        }
        Ok(())
    }
}

/// System and states of a pass; matrices are stored by groups of rows, column by column in each group.
struct Steps {
    /// `[F; C]`, applied to the states of each lane.
    own: Vec<[f64; GROUP]>,
    /// Contribution of the value's states and the inputs to each lane: `[0, G; 0, D]` for the first lane, and the
    /// system's derivative for the others.
    fed: Vec<[[f64; LANES]; GROUP]>,
    /// The first column with a contribution.
    moved: usize,
    states: usize,
    /// Number of rows in all groups.
    height: usize,
    /// States, and outputs of the previous sample, for each sample of a block.
    history: Vec<[f64; LANES]>,
    drive: Vec<f64>,
}

/// A block of samples, computed with the widest vectors of this machine.
struct Block<'a> {
    steps: &'a mut Steps,
    samples: usize,
}

impl WithSimd for Block<'_> {
    type Output = ();

    // By index: an iterator that is not inlined would not be compiled for the machine's vectors.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { steps: Steps { own, fed, moved, states, height, history, drive }, samples } = self;
        let (states, height, moved) = (*states, *height, *moved);
        let inputs = drive.len() / BLOCK;
        let width = states + inputs;
        for k in 0..samples {
            let (past, future) = history.split_at_mut((k + 1) * height);
            let state = &past[k * height..][..states];
            for group in 0..height / GROUP {
                let (own, fed) = (&own[group * width..][..width], &fed[group * width..][..width]);
                let sums = &mut future[group * GROUP..][..GROUP];
                for part in 0..LANES / S::F64_LANES {
                    let mut sum = [simd.splat_f64s(0.0); GROUP];
                    // Two separate sums halve the chain of dependent additions.
                    let mut turned = sum;
                    for j in 0..inputs {
                        let value = simd.splat_f64s(drive[j * BLOCK + k]);
                        for i in 0..GROUP {
                            sum[i] = simd.mul_add_e_f64s(load::<S>(&fed[states + j][i], part), value, sum[i]);
                        }
                    }
                    for j in moved..states {
                        let value = simd.splat_f64s(state[j][0]);
                        for i in 0..GROUP {
                            sum[i] = simd.mul_add_e_f64s(load::<S>(&fed[j][i], part), value, sum[i]);
                        }
                    }
                    for j in 0..states {
                        let values = load::<S>(&state[j], part);
                        for i in 0..GROUP {
                            turned[i] = simd.mul_add_e_f64s(simd.splat_f64s(own[j][i]), values, turned[i]);
                        }
                    }
                    for i in 0..GROUP {
                        S::as_mut_simd_f64s(&mut sums[i]).0[part] = simd.add_f64s(sum[i], turned[i]);
                    }
                }
            }
        }
    }
}

#[inline(always)]
fn load<S: Simd>(lanes: &[f64; LANES], part: usize) -> S::f64s {
    S::as_simd_f64s(lanes).0[part]
}
