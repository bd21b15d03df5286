//! Residuals of many parameter vectors in one pass over a record, a vector in each lane.
//!
//! The samples are read once for all lanes, and every lane advances a recursion of its own ([`Increments`]): two states, no
//! memory but the record's. A lane's arithmetic does not depend on its neighbours, so a vector's result depends neither on the
//! others of its batch nor on threads.

use std::array::from_fn;
use std::ops::Range;

use pulp::{Simd, WithSimd};

use crate::error::Result;
use crate::finite::all_finite;
use crate::instruction_set::arch;
use crate::linear::basis::{N, SLOPE, coefficients};
use crate::linear::delta_form::Increments;
use crate::linear::segmented_pass::interleave;
use crate::linear::{Output, Parameters};
use crate::stop::Stop;
use crate::subnormal::cut_all;

/// Vectors in a pass: two registers of AVX-512, of which one computes while the other waits.
pub const LANES: usize = 16;
/// Samples between looks at the flag that stops. Their squares are summed apart, which keeps digits that one long sum would lose.
const BLOCK: usize = 512;

/// One number of each lane.
type Pack = [f64; LANES];

/// What is measured, cut where samples begin or cease to count.
pub struct Course<'a, const O: usize> {
    pub set: &'a [f64],
    pub initial: [f64; 2],
    pub measured: [&'a [f64]; O],
    pub stretches: &'a [Stretch],
}

impl<const O: usize> Course<'_, O> {
    /// Write each lane's set point from one sample before `start` on; before and after the record its ends hold.
    fn lay(&self, late: [usize; LANES], start: usize, into: &mut [Pack]) {
        let inside = |late: usize| start > late && start - late - 1 + into.len() <= self.set.len();
        if late.into_iter().all(inside) {
            interleave(&late.map(|late| &self.set[start - late - 1..]), into);
        } else {
            for (k, pack) in (start..).zip(into) {
                *pack = late
                    .map(|late| self.set[k.saturating_sub(late).saturating_sub(1).min(self.set.len() - 1)]);
            }
        }
    }
}

/// A stretch of samples that all count, or none of which counts.
pub struct Stretch {
    samples: Range<usize>,
    counts: bool,
}

impl Stretch {
    /// The stretches of a record; no longer than a block each.
    pub fn of(measured: &[f64], samples: usize) -> Vec<Self> {
        let mut stretches: Vec<Self> = Vec::new();
        for start in (0..samples).step_by(BLOCK) {
            let block = start..samples.min(start + BLOCK);
            if measured.chunks_exact(samples).all(|row| all_finite(&row[block.clone()])) {
                stretches.push(Self { samples: block, counts: true });
                continue;
            }
            for k in block {
                let counts = measured[k..].iter().step_by(samples).all(|value| value.is_finite());
                match stretches.last_mut() {
                    Some(last) if last.counts == counts && k != start => last.samples.end = k + 1,
                    _ => stretches.push(Self { samples: k..k + 1, counts }),
                }
            }
        }
        stretches
    }

    /// Number of samples that count.
    pub fn count(stretches: &[Self]) -> usize {
        stretches.iter().filter(|stretch| stretch.counts).map(|stretch| stretch.samples.len()).sum()
    }
}

/// A parameter vector, and its recursion.
pub struct Member {
    pub parameters: Parameters,
    pub increments: Increments,
}

/// The recursions of all lanes.
struct Recursion<const O: usize> {
    lead: Pack,
    keep: Pack,
    pull: Pack,
    push: [Pack; 2],
    /// For each output the factors of the set point, the error, the change and the set point's last step in its residual.
    reads: [[Pack; 4]; O],
    error: Pack,
    change: Pack,
}

impl<const O: usize> Recursion<O> {
    fn new(members: [&Member; LANES], outputs: [Output; O], start: [[f64; 2]; LANES]) -> Self {
        let each = |field: fn(&Increments) -> f64| members.map(|member| field(&member.increments));
        let read = |output: Output, Member { parameters, increments }: &Member| {
            let factors = coefficients(output, parameters);
            let (of_speed, of_rate) = (factors[N], factors[SLOPE]);
            let [error, change, step] = increments.slope.map(|slope| -of_rate * slope);
            [-of_speed, of_speed + error, change, step]
        };
        Self {
            lead: each(|increments| increments.lead),
            keep: each(|increments| increments.keep),
            pull: each(|increments| increments.pull),
            push: [each(|increments| increments.push[0]), each(|increments| increments.push[1])],
            reads: outputs.map(|output| {
                let reads = members.map(|member| read(output, member));
                from_fn(|term| reads.map(|read| read[term]))
            }),
            error: start.map(|[error, _]| error),
            change: start.map(|[_, change]| change),
        }
    }
}

/// Sums of products of the residuals of each pair of outputs, the first not after the second.
pub type Scatter<const O: usize> = [[Pack; O]; O];

/// The scatter of every lane's residuals. `SPEED`: the first output is the speed. `BETWEEN`: set points may be late.
pub fn scatter<const O: usize, const SPEED: bool, const BETWEEN: bool>(
    members: [&Member; LANES],
    outputs: [Output; O],
    course: &Course<'_, O>,
    stop: &Stop,
) -> Result<Scatter<O>> {
    let start = members.map(|member| member.increments.start(course.initial, course.set[0]));
    let mut recursion = Recursion::new(members, outputs, start);
    let late = members.map(|member| member.increments.late);
    let mut sums = [[[0.0; LANES]; O]; O];
    let mut sets = vec![[0.0; LANES]; if BETWEEN { BLOCK + 2 } else { 0 }];
    for stretch in course.stretches {
        stop.check()?;
        let Range { start, end } = stretch.samples;
        if BETWEEN {
            course.lay(late, start, &mut sets[..end - start + 2]);
        }
        arch().dispatch(March::<O, SPEED, BETWEEN> {
            course,
            stretch,
            sets: &sets,
            recursion: &mut recursion,
            sums: &mut sums,
        });
        cut_all(&mut recursion.error);
        cut_all(&mut recursion.change);
    }
    Ok(sums)
}

/// Advance all lanes through a stretch.
struct March<'a, const O: usize, const SPEED: bool, const BETWEEN: bool> {
    course: &'a Course<'a, O>,
    stretch: &'a Stretch,
    sets: &'a [Pack],
    recursion: &'a mut Recursion<O>,
    sums: &'a mut Scatter<O>,
}

impl<const O: usize, const SPEED: bool, const BETWEEN: bool> WithSimd for March<'_, O, SPEED, BETWEEN> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let registers = LANES / S::F64_LANES;
        for first in (0..registers).step_by(2) {
            if self.stretch.counts {
                self.registers::<S, 2, true>(simd, first);
            } else {
                self.registers::<S, 2, false>(simd, first);
            }
        }
    }
}

#[inline(always)]
#[allow(clippy::manual_memcpy)] // a copy of so few is a call
fn load<S: Simd, const R: usize>(simd: S, pack: &Pack, first: usize) -> [S::f64s; R] {
    let registers = S::as_simd_f64s(pack).0;
    let mut loaded = [simd.splat_f64s(0.0); R];
    for r in 0..R {
        loaded[r] = registers[first + r];
    }
    loaded
}

#[inline(always)]
#[allow(clippy::needless_range_loop)] // an iterator that is not inlined would not be compiled for the machine's vectors
fn load_reads<S: Simd, const R: usize, const O: usize>(
    simd: S,
    reads: &[[Pack; 4]; O],
    first: usize,
) -> [[[S::f64s; R]; 4]; O] {
    let mut loaded = [[[simd.splat_f64s(0.0); R]; 4]; O];
    for output in 0..O {
        for term in 0..4 {
            loaded[output][term] = load(simd, &reads[output][term], first);
        }
    }
    loaded
}

#[inline(always)]
#[allow(clippy::manual_memcpy)] // as above
fn store<S: Simd, const R: usize>(pack: &mut Pack, first: usize, values: [S::f64s; R]) {
    let registers = S::as_mut_simd_f64s(pack).0;
    for r in 0..R {
        registers[first + r] = values[r];
    }
}

/// `R` registers of lanes: the set point and its last step, the error and its change.
struct Now<S: Simd, const R: usize> {
    set: [S::f64s; R],
    step: [S::f64s; R],
    error: [S::f64s; R],
    change: [S::f64s; R],
}

impl<const O: usize, const SPEED: bool, const BETWEEN: bool> March<'_, O, SPEED, BETWEEN> {
    /// `R` registers of lanes from the `first` on. `COUNTS`: residuals are summed.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // an iterator that is not inlined would not be compiled for the machine's vectors
    fn registers<S: Simd, const R: usize, const COUNTS: bool>(&mut self, simd: S, first: usize) {
        let Recursion { lead, keep, pull, push, reads, error, change } = &mut *self.recursion;
        let zero = [simd.splat_f64s(0.0); R];
        let (lead, keep, pull) = (
            load::<S, R>(simd, lead, first),
            load::<S, R>(simd, keep, first),
            load::<S, R>(simd, pull, first),
        );
        let push = [load::<S, R>(simd, &push[0], first), load::<S, R>(simd, &push[1], first)];
        let factors = load_reads::<S, R, O>(simd, reads, first);
        let mut sums = [[zero; O]; O];
        let Range { start, end } = self.stretch.samples;
        let set = &self.course.set[start..];
        let after = &set[1.min(set.len() - 1)..];
        let mut measured = [&set[..0]; O];
        for output in 0..O {
            measured[output] = &self.course.measured[output][start..end];
        }
        let mut now = Now::<S, R> {
            set: if BETWEEN { load(simd, &self.sets[1], first) } else { [simd.splat_f64s(set[0]); R] },
            step: zero,
            error: load(simd, error, first),
            change: load(simd, change, first),
        };
        if BETWEEN {
            let before = load::<S, R>(simd, &self.sets[0], first);
            for r in 0..R {
                now.step[r] = simd.sub_f64s(now.set[r], before[r]);
            }
        }
        for k in 0..end - start {
            let next = if BETWEEN {
                load(simd, &self.sets[k + 2], first)
            } else {
                [simd.splat_f64s(if k < after.len() { after[k] } else { after[after.len() - 1] }); R]
            };
            if COUNTS {
                let mut values = [zero[0]; O];
                for output in 0..O {
                    values[output] = simd.splat_f64s(measured[output][k]);
                }
                Self::add(simd, &values, &now, &factors, &mut sums);
            }
            for r in 0..R {
                let to_come = simd.sub_f64s(next[r], now.set[r]);
                let mut fed = simd.mul_f64s(push[1][r], to_come);
                if BETWEEN {
                    fed = simd.mul_add_e_f64s(push[0][r], now.step[r], fed);
                }
                fed = simd.mul_add_e_f64s(pull[r], now.error[r], fed);
                let before = simd.sub_f64s(now.error[r], now.change[r]);
                now.error[r] = simd.mul_add_e_f64s(lead[r], to_come, before);
                now.change[r] = simd.mul_add_e_f64s(keep[r], now.change[r], fed);
                now.step[r] = to_come;
            }
            now.set = next;
        }
        store::<S, R>(error, first, now.error);
        store::<S, R>(change, first, now.change);
        self.add_up(simd, first, &sums);
    }

    /// Add the products of one sample's residuals to the sums.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // as above
    fn add<S: Simd, const R: usize>(
        simd: S,
        values: &[S::f64s; O],
        now: &Now<S, R>,
        factors: &[[[S::f64s; R]; 4]; O],
        sums: &mut [[[S::f64s; R]; O]; O],
    ) {
        let mut residuals = [[simd.splat_f64s(0.0); R]; O];
        for output in 0..O {
            let factors = &factors[output];
            for r in 0..R {
                residuals[output][r] = if SPEED && output == 0 {
                    simd.add_f64s(simd.sub_f64s(values[output], now.set[r]), now.error[r])
                } else {
                    let mut residual = simd.mul_add_e_f64s(factors[0][r], now.set[r], values[output]);
                    residual = simd.mul_add_e_f64s(factors[1][r], now.error[r], residual);
                    if BETWEEN {
                        residual = simd.mul_add_e_f64s(factors[3][r], now.step[r], residual);
                    }
                    simd.mul_add_e_f64s(factors[2][r], now.change[r], residual)
                };
            }
        }
        for i in 0..O {
            for j in i..O {
                for r in 0..R {
                    sums[i][j][r] = simd.mul_add_e_f64s(residuals[i][r], residuals[j][r], sums[i][j][r]);
                }
            }
        }
    }

    /// Add a stretch's sums to the record's.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // as above
    fn add_up<S: Simd, const R: usize>(&mut self, simd: S, first: usize, sums: &[[[S::f64s; R]; O]; O]) {
        for i in 0..O {
            for j in i..O {
                let mut total = load::<S, R>(simd, &self.sums[i][j], first);
                for r in 0..R {
                    total[r] = simd.add_f64s(total[r], sums[i][j][r]);
                }
                store::<S, R>(&mut self.sums[i][j], first, total);
            }
        }
    }
}
