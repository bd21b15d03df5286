//! One pass over a chunk of a train: the samples at which the detector fires, and the times of the preceding crossings.

use multiversion::multiversion;
use multiversion::target::match_target;

use super::sample::{BLOCK, Masks, Sample};
use super::thresholds::{Edge, Levels};
use crate::error::Result;
use crate::stop::{CHECK_EVERY, Stop};

/// State of the detector between two chunks.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cursor {
    /// Number of samples so far.
    pub seen: u64,
    /// Whether there was a sample at or below `low` since the last crossing or gap.
    pub armed: bool,
    /// The last sample; NaN at the start and in a gap.
    pub previous: f64,
    /// Last upward crossing of the middle level; valid if `armed`, and if `previous` is at or above the middle level.
    pub pending: Edge,
    /// First sample of an open gap.
    pub gap_start: Option<u64>,
}

/// Results of a pass: crossings, finished stretches of missing samples, and the new state.
pub(super) struct Passed<E> {
    pub edges: Vec<E>,
    pub gaps: Vec<(u64, u64)>,
    pub cursor: Cursor,
}

/// Pass over a chunk with thresholds in the samples' type.
///
/// # Errors
/// On a stop.
pub(super) fn passed<T: Sample, E: From<Edge>>(
    chunk: &[T],
    levels: Levels,
    cursor: Cursor,
    (low, high): (T, T),
    stop: &Stop,
) -> Result<Passed<E>> {
    let mut whole = Scan { chunk, levels, cursor, edges: Vec::new(), gaps: Vec::new() };
    advance(&mut whole, low, high, stop)?;
    whole.close();
    Ok(Passed { edges: whole.edges, gaps: whole.gaps, cursor: whole.cursor })
}

/// Pass over a chunk without missing samples, of which all crossings but the first are known.
pub(super) fn timed<T: Sample>(
    chunk: &[T],
    levels: Levels,
    cursor: Cursor,
    (first, others): (usize, Vec<Edge>),
    armed: bool,
) -> Passed<Edge> {
    let mut whole =
        Scan { chunk, levels, cursor, edges: Vec::with_capacity(others.len() + 1), gaps: Vec::new() };
    if let Some(from) = whole.cursor.gap_start.take() {
        whole.gaps.push((from, cursor.seen));
    }
    whole.edges.push(whole.crossing(first));
    whole.edges.extend(others);
    whole.cursor.armed = armed;
    whole.close();
    Passed { edges: whole.edges, gaps: whole.gaps, cursor: whole.cursor }
}

/// Whether the detector is armed after these samples; None if these samples do not determine it.
pub(super) fn armed_after<T: Sample>(samples: &[T], low: T, high: T) -> Option<bool> {
    let tells = |&&x: &&T| x <= low || x >= high || x.is_gap();
    samples.iter().rev().find(tells).map(|&x| x <= low)
}

/// Process all blocks of a chunk; compiled for each instruction set and chosen at run time.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+bmi1+bmi2+fma+lzcnt+popcnt",
    "x86_64+avx2+bmi1+bmi2+fma+lzcnt+popcnt"
))]
fn advance<T: Sample, E: From<Edge>>(scan: &mut Scan<'_, T, E>, low: T, high: T, stop: &Stop) -> Result<()> {
    const MASK_REGISTERS: bool = match_target! { "x86_64+avx512bw" => true, _ => false };
    let mut fires = Fires::new();
    let chunk = scan.chunk;
    for (start, batch) in (0..).step_by(BATCH).zip(chunk.chunks(BATCH)) {
        if start % CHECK_EVERY == 0 {
            stop.check()?;
        }
        let (blocks, rest) = batch.as_chunks::<BLOCK>();
        for (index, block) in blocks.iter().enumerate() {
            let masks = Masks::of::<T, MASK_REGISTERS>(block, low, high);
            fires.push(index * BLOCK, scan.step(start + index * BLOCK, BLOCK, masks));
        }
        if !rest.is_empty() {
            let mut padded = [low; BLOCK];
            padded[..rest.len()].copy_from_slice(rest);
            let masks = Masks::of::<T, MASK_REGISTERS>(&padded, low, high).first(rest.len());
            let offset = blocks.len() * BLOCK;
            fires.push(offset, scan.step(start + offset, rest.len(), masks));
        }
        scan.take_times(start, &mut fires);
    }
    Ok(())
}

/// Samples between two rounds of timing; they stay in the fastest cache.
pub(super) const BATCH: usize = 4096;

/// Samples of a batch at which the detector fired, at most every second one.
///
/// Two entries are always written for each block, without a branch: most blocks fire once or never, in an unpredictable
/// order.
pub(super) struct Fires {
    at: [u32; BATCH / 2 + 2],
    count: usize,
}

impl Fires {
    pub const fn new() -> Self {
        Self { at: [0; BATCH / 2 + 2], count: 0 }
    }

    pub fn taken(&self) -> &[u32] {
        &self.at[..self.count]
    }

    pub const fn clear(&mut self) {
        self.count = 0;
    }

    #[allow(clippy::inline_always)]
    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)] // a batch is short
    pub fn push(&mut self, offset: usize, mut bits: u64) {
        let count = bits.count_ones() as usize;
        let room = &mut self.at[self.count..];
        for slot in &mut room[..2] {
            *slot = offset as u32 + bits.trailing_zeros();
            bits &= bits.wrapping_sub(1);
        }
        if count > 2 {
            for slot in &mut room[2..count] {
                *slot = offset as u32 + bits.trailing_zeros();
                bits &= bits.wrapping_sub(1);
            }
        }
        self.count += count;
    }
}

/// Samples at which a block fires, and whether the detector is armed after it.
///
/// "Armed" is a latch that `low` sets and `high` or a gap resets. An adder's carry is such a latch (generate = set,
/// propagate = hold), so one addition runs the state machine over the whole block.
#[allow(clippy::inline_always)]
#[inline(always)]
pub(super) fn armed_by(masks: Masks, armed: &mut bool) -> u64 {
    let hold = masks.low | !(masks.high | masks.gap);
    let sum = u128::from(hold) + u128::from(masks.low) + u128::from(*armed);
    #[allow(clippy::cast_possible_truncation)] // only the low word is needed
    let armed_before = sum as u64 ^ hold ^ masks.low;
    *armed = sum >> 64 != 0;
    armed_before & masks.high
}

/// One pass over a chunk.
struct Scan<'a, T, E> {
    chunk: &'a [T],
    levels: Levels,
    /// State at the chunk's start, except for `armed` and `gap_start`, which follow the blocks.
    cursor: Cursor,
    edges: Vec<E>,
    gaps: Vec<(u64, u64)>,
}

impl<T: Sample, E: From<Edge>> Scan<'_, T, E> {
    /// Process a block of `count` samples from `start`; return where it fires.
    #[allow(clippy::inline_always)]
    #[inline(always)]
    fn step(&mut self, start: usize, count: usize, masks: Masks) -> u64 {
        let fires = armed_by(masks, &mut self.cursor.armed);
        if masks.gap != 0 || self.cursor.gap_start.is_some() {
            self.note_gaps(start, count, masks.gap);
        }
        fires
    }

    /// Compute the crossing times for the fires of the batch from `start`.
    fn take_times(&mut self, start: usize, fires: &mut Fires) {
        self.edges.reserve(fires.count);
        for &at in fires.taken() {
            let edge = self.crossing(start + at as usize);
            self.edges.push(edge.into());
        }
        fires.clear();
    }

    /// Last upward crossing of the middle level up to sample `index` of the chunk; this sample is at or above the level.
    ///
    /// The backward search ends at the latest where the detector was armed.
    #[inline]
    fn crossing(&self, index: usize) -> Edge {
        // A separate loop for a changing middle, so that a constant one takes no extra time.
        if self.levels.slope == 0.0 {
            self.crossing_of(index, |_| self.levels.middle)
        } else {
            self.crossing_of(index, |sample| self.levels.middle_at(sample))
        }
    }

    #[inline]
    fn crossing_of(&self, index: usize, middle_at: impl Fn(u64) -> f64) -> Edge {
        let seen = self.cursor.seen;
        let mut upper = index;
        while upper > 0 && self.chunk[upper - 1].into() >= middle_at(seen + upper as u64 - 1) {
            upper -= 1;
        }
        let at = seen + upper as u64;
        let (middle, below) = (middle_at(at), middle_at(at.wrapping_sub(1)));
        let before = if upper > 0 { self.chunk[upper - 1].into() } else { self.cursor.previous };
        if before >= below {
            return self.cursor.pending;
        }
        let after = self.chunk[upper].into();
        let rise = (after - before) - (middle - below);
        let time = if rise.is_finite() { at as f64 - (after - middle) / rise } else { at as f64 };
        Edge { time, rise: if rise.is_nan() { f64::INFINITY } else { rise } }
    }

    #[cold]
    fn note_gaps(&mut self, start: usize, count: usize, gap: u64) {
        let open = u64::from(self.cursor.gap_start.is_some());
        let mut edges = (gap ^ (gap << 1 | open)) & (u64::MAX >> (BLOCK - count));
        while edges != 0 {
            let at = self.cursor.seen + (start + edges.trailing_zeros() as usize) as u64;
            match self.cursor.gap_start.take() {
                Some(from) => self.gaps.push((from, at)),
                None => self.cursor.gap_start = Some(at),
            }
            edges &= edges - 1;
        }
    }

    /// Update the state after the chunk.
    fn close(&mut self) {
        let Some(&last) = self.chunk.last() else { return };
        let middle = self.levels.middle_at(self.cursor.seen + self.chunk.len() as u64 - 1);
        if self.cursor.armed && last.into() >= middle {
            self.cursor.pending = self.crossing(self.chunk.len() - 1);
        }
        self.cursor.previous = last.into();
        self.cursor.seen += self.chunk.len() as u64;
    }
}
