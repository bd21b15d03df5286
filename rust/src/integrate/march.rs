//! The loop over samples.

use std::marker::PhantomData;
use std::ops::Range;

use super::method::{Change, Method};
use super::run::Run;
use super::scheme::{Hold, Scheme};
use crate::error::{Error, Result};
use crate::plant::{Limit, Motion, Power, State, times_plus};
use crate::stop::{CHECK_EVERY, Stop};
use crate::subnormal::cut_all;

/// Rows of an output.
pub const ROWS: usize = 4;
const ROW_NAMES: [&str; ROWS] = ["n_s", "E_n", "X_f", "M_b"];

/// Samples between two looks at whether the state is finite.
const STRETCH: usize = 128;

/// March through all samples. A state that is no longer finite never becomes finite again, so a look at the end of each
/// stretch finds every one.
#[inline(always)]
pub fn march<M: Method, P: Power, L: Limit, const FUSED: bool>(
    run: &Run<'_>,
    mut limit: L,
    scheme: &Scheme,
    output: &mut [f64],
    stop: &Stop,
) -> Result<()> {
    let (set_speed, substeps) = (run.set_speed, scheme.substeps);
    let motion = Motion::new(&run.plant, scheme.dt / substeps as f64 * M::UNIT);
    // Part of the interval between two set points that a step covers.
    let part = match scheme.hold {
        Hold::Zero => 0.0,
        Hold::First => 1.0 / substeps as f64,
    };
    let mut state = motion.state(run.initial);
    let mut rows: Vec<_> = output.chunks_exact_mut(set_speed.len()).collect();
    let most = (CHECK_EVERY / substeps).clamp(1, STRETCH);
    for from in (0..set_speed.len()).step_by(most) {
        let to = set_speed.len().min(from + most);
        for k in from..to {
            let start = set_speed[k];
            let slope = (set_speed[set_speed.len().min(k + 2) - 1] - start) * part;
            for substep in 0..substeps {
                let set = times_plus::<FUSED>(slope, substep as f64, start);
                let push = motion.push::<FUSED>(&mut limit, set, state);
                if substep == 0 {
                    for (row, value) in rows.iter_mut().zip(motion.record::<FUSED>(push, set, state)) {
                        row[k] = value;
                    }
                } else if substep % CHECK_EVERY == 0 {
                    stop.check()?;
                }
                let first = motion.change::<P, FUSED>(push, set, state);
                let mut step =
                    Step { motion: &motion, limit: &mut limit, set, slope, power: PhantomData::<P> };
                state = M::advance::<FUSED>(state, first, &mut step);
            }
        }
        let mut numbers = [state.speed, state.error];
        cut_all(&mut numbers);
        state = State { speed: numbers[0], error: numbers[1] };
        if !numbers.iter().all(|value| value.is_finite()) {
            require_finite(&rows, from..to, scheme.dt)?;
        }
        stop.check()?;
    }
    Ok(())
}

/// Refuse a stretch in which a result is not finite.
#[cold]
fn require_finite(rows: &[&mut [f64]], stretch: Range<usize>, dt: f64) -> Result<()> {
    let bad = |row: &[f64]| row[stretch.clone()].iter().position(|value| !value.is_finite());
    let each = rows.iter().enumerate();
    match each.filter_map(|(row, values)| Some((stretch.start + bad(values)?, row))).min() {
        None => Ok(()),
        Some((sample, row)) => {
            Err(Error::Diverged { sample, time: sample as f64 * dt, what: ROW_NAMES[row] })
        }
    }
}

/// A step under a set point that moves evenly.
struct Step<'a, L, P> {
    motion: &'a Motion,
    limit: &'a mut L,
    set: f64,
    slope: f64,
    power: PhantomData<P>,
}

impl<L: Limit, P: Power> Change for Step<'_, L, P> {
    #[inline(always)]
    fn over<const FUSED: bool>(&mut self, passed: f64, state: State) -> State {
        let set = times_plus::<FUSED>(self.slope, passed, self.set);
        self.motion.change::<P, FUSED>(self.motion.push::<FUSED>(self.limit, set, state), set, state)
    }
}
