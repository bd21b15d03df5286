//! Rising crossings of a level with hysteresis, over chunks of any length.

use multiversion::multiversion;
use multiversion::target::match_target;

use super::gaps::Gaps;
use super::sample::{BLOCK, Masks, Sample};
use super::thresholds::{Edge, Levels};
use crate::error::{Error, Result};
use crate::stop::{CHECK_EVERY, Stop};

/// Where the detector stands between two chunks.
#[derive(Debug, Clone, Copy)]
struct Cursor {
    /// Samples seen so far.
    seen: u64,
    /// A sample at or below `low` came after the last crossing or gap.
    armed: bool,
    /// The last sample; NaN at the start and in a gap.
    previous: f64,
    /// The last upward crossing of the middle; means something while armed with `previous` at or above it.
    pending: Edge,
    /// First sample of the gap that is still open.
    gap_start: Option<u64>,
}

/// A detector of pulses: armed by a sample at or below `low`, it fires at the next one at or above `high`, and the
/// crossing of `middle` that led there is interpolated linearly.
///
/// A missing sample (NaN) disarms it, so no crossing is interpolated over a gap. An infinite sample is a saturated one:
/// it counts as high or low, but a crossing next to it is put at the later sample.
#[derive(Debug, Clone)]
pub struct PulseCrossings {
    levels: Levels,
    cursor: Cursor,
    gaps: Gaps,
}

impl PulseCrossings {
    /// A detector that has seen nothing.
    ///
    /// # Errors
    /// Unless `low < middle < high`, all finite.
    pub fn new(low: f64, high: f64, middle: f64) -> Result<Self> {
        let levels = Levels { low, high, middle, slope: 0.0, origin: 0 };
        levels.check()?;
        let cursor =
            Cursor { seen: 0, armed: false, previous: f64::NAN, pending: Edge::NONE, gap_start: None };
        Ok(Self { levels, cursor, gaps: Gaps::default() })
    }

    /// Go on with other levels, for a train whose levels drift.
    ///
    /// # Errors
    /// Unless `low < middle < high`, all finite; the levels are then as they were before.
    pub fn set_levels(&mut self, low: f64, high: f64, middle: f64) -> Result<()> {
        self.follow(Levels { low, high, middle, slope: 0.0, origin: self.cursor.seen })
    }

    /// Go on with other levels, whose middle has to stay between the thresholds for as long as they hold.
    ///
    /// # Errors
    /// As [`Self::set_levels`].
    pub fn follow(&mut self, levels: Levels) -> Result<()> {
        levels.check()?;
        let previous = self.cursor.previous;
        let last = self.cursor.seen.wrapping_sub(1);
        if previous < self.levels.middle_at(last) && previous >= levels.middle_at(last) {
            // The level came down through the signal: the last sample is where the two met.
            self.cursor.pending = Edge { time: last as f64, rise: f64::INFINITY };
        }
        self.levels = levels;
        Ok(())
    }

    /// Forget a low sample seen before: the next pulse has to be armed anew.
    pub fn disarm(&mut self) {
        self.cursor.armed = false;
    }

    /// Samples seen so far.
    #[must_use]
    pub const fn seen(&self) -> u64 {
        self.cursor.seen
    }

    /// Stretches of missing samples, each from its first to past its last; one that is still open ends at [`Self::seen`].
    /// Of more than 65,536 the nearest ones are told as one.
    pub fn gaps(&self) -> impl Iterator<Item = (u64, u64)> {
        let open = self.cursor.gap_start.map(|start| (start, self.cursor.seen));
        self.gaps.spans().chain(open)
    }

    /// Times of the rising crossings found in the next chunk, in samples since the very first.
    ///
    /// # Errors
    /// If the sample type can't hold a threshold, or on a stop; the detector is then as it was before.
    pub fn feed<T: Sample>(&mut self, chunk: &[T], stop: &Stop) -> Result<Vec<f64>> {
        let edges = self.edges(chunk, stop)?;
        Ok(edges.into_iter().map(|edge| edge.time).collect())
    }

    /// As [`Self::feed`], each crossing with its rise.
    ///
    /// # Errors
    /// As [`Self::feed`].
    pub fn edges<T: Sample>(&mut self, chunk: &[T], stop: &Stop) -> Result<Vec<Edge>> {
        let outside = |name: &str, level: f64| {
            Error::Invalid(format!(
                "{name} = {level} is outside the range of {} samples; give levels in their unit",
                T::NAME
            ))
        };
        let Levels { low, high, .. } = self.levels;
        let low = T::at_or_below(low).ok_or_else(|| outside("low", low))?;
        let high = T::at_or_above(high).ok_or_else(|| outside("high", high))?;
        let mut scan =
            Scan { chunk, levels: self.levels, cursor: self.cursor, edges: Vec::new(), gaps: Vec::new() };
        advance(&mut scan, low, high, stop)?;
        scan.close();
        self.cursor = scan.cursor;
        scan.gaps.into_iter().for_each(|gap| self.gaps.push(gap));
        Ok(scan.edges)
    }
}

/// Run over all blocks of a chunk; compiled once for each instruction set and chosen at run time.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+bmi1+bmi2+fma+lzcnt+popcnt",
    "x86_64+avx2+bmi1+bmi2+fma+lzcnt+popcnt"
))]
fn advance<T: Sample>(scan: &mut Scan<'_, T>, low: T, high: T, stop: &Stop) -> Result<()> {
    const MASK_REGISTERS: bool = match_target! { "x86_64+avx512bw" => true, _ => false };
    let mut fires = Fires { at: [0; BATCH / 2 + 2], count: 0 };
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

/// Samples between two rounds of timing: they stay in the fastest cache.
const BATCH: usize = 4096;

/// Samples of a batch at which the detector fired, at most every other one.
///
/// Two are written for every block whether they are there or not: most blocks have one or none, which no branch
/// predictor can guess.
struct Fires {
    at: [u32; BATCH / 2 + 2],
    count: usize,
}

impl Fires {
    #[allow(clippy::inline_always)]
    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)] // a batch is short
    fn push(&mut self, offset: usize, mut bits: u64) {
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

/// One pass over a chunk.
struct Scan<'a, T> {
    chunk: &'a [T],
    levels: Levels,
    /// As it was at the chunk's start, but for `armed` and `gap_start`, which move with the blocks.
    cursor: Cursor,
    edges: Vec<Edge>,
    gaps: Vec<(u64, u64)>,
}

impl<T: Sample> Scan<'_, T> {
    /// Take one block of `count` samples from `start` on; return where it fires.
    ///
    /// "Armed" is a latch that `low` sets and `high` or a gap resets. An adder's carry is such a latch (generate =
    /// set, propagate = hold), so one addition runs the state machine over the whole block.
    #[allow(clippy::inline_always)]
    #[inline(always)]
    fn step(&mut self, start: usize, count: usize, masks: Masks) -> u64 {
        let hold = masks.low | !(masks.high | masks.gap);
        let sum = u128::from(hold) + u128::from(masks.low) + u128::from(self.cursor.armed);
        #[allow(clippy::cast_possible_truncation)] // the low word is wanted
        let armed_before = sum as u64 ^ hold ^ masks.low;
        self.cursor.armed = sum >> 64 != 0;
        if masks.gap != 0 || self.cursor.gap_start.is_some() {
            self.note_gaps(start, count, masks.gap);
        }
        armed_before & masks.high
    }

    /// Time the crossings that led to the fires of the batch from `start` on.
    fn take_times(&mut self, start: usize, fires: &mut Fires) {
        self.edges.reserve(fires.count);
        for &at in &fires.at[..fires.count] {
            let edge = self.crossing(start + at as usize);
            self.edges.push(edge);
        }
        fires.count = 0;
    }

    /// The last upward crossing of the middle at or before sample `index` of the chunk, which is at or above it.
    ///
    /// The walk back ends at the latest where the detector was armed.
    #[inline]
    fn crossing(&self, index: usize) -> Edge {
        // Apart, so that a level middle costs nothing.
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

    /// Leave the cursor behind the chunk.
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn run<T: Sample>(chunks: &[&[T]]) -> (Vec<f64>, Vec<(u64, u64)>) {
        let mut detector = PulseCrossings::new(1.0, 3.0, 2.0).unwrap();
        let times = chunks.iter().flat_map(|chunk| detector.feed(chunk, &Stop::new()).unwrap()).collect();
        (times, detector.gaps().collect())
    }

    /// The rules said sample by sample.
    fn reference(samples: &[f64]) -> (Vec<f64>, Vec<(u64, u64)>) {
        let (mut times, mut gaps) = (Vec::new(), Vec::<(u64, u64)>::new());
        let (mut armed, mut previous, mut crossing) = (false, f64::NAN, f64::NAN);
        for (k, &x) in samples.iter().enumerate() {
            if x.is_nan() {
                armed = false;
                match gaps.last_mut() {
                    Some(gap) if gap.1 == k as u64 => gap.1 += 1,
                    _ => gaps.push((k as u64, k as u64 + 1)),
                }
            }
            if previous < 2.0 && x >= 2.0 {
                let finite = previous.is_finite() && x.is_finite();
                crossing = if finite { k as f64 - (x - 2.0) / (x - previous) } else { k as f64 };
            }
            if x <= 1.0 {
                armed = true;
            } else if armed && x >= 3.0 {
                times.push(crossing);
                armed = false;
            }
            previous = x;
        }
        (times, gaps)
    }

    fn sample() -> impl Strategy<Value = f64> {
        prop_oneof![
            6 => Just(0.5),
            6 => Just(3.5),
            8 => 0.0..4.0,
            1 => Just(2.0),
            1 => Just(1.0),
            1 => Just(3.0),
            1 => Just(f64::NAN),
            1 => Just(f64::INFINITY),
            1 => Just(f64::NEG_INFINITY),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        #[test]
        fn any_train_in_any_chunks_gives_what_the_rules_say(
            samples in prop::collection::vec(sample(), 0..300),
            cuts in prop::collection::vec(0..300_usize, 0..6),
        ) {
            let mut cuts: Vec<usize> = cuts.into_iter().filter(|&cut| cut < samples.len()).collect();
            cuts.extend([0, samples.len()]);
            cuts.sort_unstable();
            let chunks: Vec<&[f64]> = cuts.windows(2).map(|pair| &samples[pair[0]..pair[1]]).collect();
            prop_assert_eq!(run(&chunks), reference(&samples));
            let singly: Vec<&[f64]> = samples.chunks(1).collect();
            prop_assert_eq!(run(&singly), reference(&samples));
        }
    }

    #[test]
    fn a_slow_edge_is_crossed_where_it_last_rose_through_the_middle() {
        assert_eq!(run(&[&[0.0_f32, 1.5, 2.5, 1.5, 2.5, 2.6, 3.0]]).0, [3.5]);
        assert_eq!(run(&[&[0_i16, 1, 3, 0, 2, 3]]).0, [1.5, 4.0]);
    }

    #[test]
    fn no_pulse_is_seen_before_the_train_was_low_or_over_a_gap() {
        assert!(run(&[&[4.0, 4.0, 2.0, 4.0]]).0.is_empty());
        assert_eq!(run(&[&[0.0, f64::NAN, 4.0], &[f64::NAN], &[f64::NAN]]), (vec![], vec![(1, 2), (3, 5)]));
    }

    #[test]
    fn levels_may_change_between_chunks() {
        let mut detector = PulseCrossings::new(1.0, 3.0, 2.0).unwrap();
        assert!(detector.feed(&[0.0, 1.5], &Stop::new()).unwrap().is_empty());
        detector.set_levels(0.5, 2.5, 1.25).unwrap();
        assert_eq!(detector.feed(&[2.0, 3.0, 0.0, 5.0], &Stop::new()).unwrap(), [1.0, 4.25]);
        assert!(detector.set_levels(1.0, 0.0, 0.5).is_err());
    }

    #[test]
    fn levels_out_of_order_or_out_of_range_are_refused() {
        assert!(PulseCrossings::new(2.0, 1.0, 1.5).unwrap_err().to_string().contains("low < middle < high"));
        assert!(PulseCrossings::new(f64::NAN, 1.0, 0.5).is_err());
        let mut volts = PulseCrossings::new(0.0, 40_000.0, 5.0).unwrap();
        assert!(
            volts.feed(&[0_i16], &Stop::new()).unwrap_err().to_string().contains("high = 40000 is outside")
        );
    }

    #[test]
    fn a_stopped_feed_leaves_the_detector_as_it_was() {
        let mut detector = PulseCrossings::new(1.0, 3.0, 2.0).unwrap();
        let stop = Stop::new();
        stop.request();
        assert_eq!(detector.feed(&[0.0; 100], &stop), Err(Error::Stopped));
        assert_eq!(detector.seen(), 0);
    }
}
