//! Rising crossings of a level with hysteresis, over chunks of any length.

use super::gaps::Gaps;
use super::sample::Sample;
use super::scan::{Cursor, Passed, passed, timed};
use super::thresholds::{Edge, Levels};
use crate::error::Result;
use crate::stop::Stop;

/// A detector of pulses. A sample at or below `low` arms the detector; the next sample at or above `high` fires it. The
/// time is that of the preceding crossing of `middle`, interpolated linearly.
///
/// A missing sample (NaN) disarms it, so that no crossing is interpolated over a gap. An infinite sample is saturated: it
/// counts as high or low, but a crossing next to it gets the time of the later sample.
#[derive(Debug, Clone)]
pub struct PulseCrossings {
    levels: Levels,
    cursor: Cursor,
    gaps: Gaps,
}

impl PulseCrossings {
    /// A detector before its first sample.
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

    /// Change the levels, for a train whose levels drift.
    ///
    /// # Errors
    /// Unless `low < middle < high`, all finite; the previous levels then remain.
    pub fn set_levels(&mut self, low: f64, high: f64, middle: f64) -> Result<()> {
        self.follow(Levels { low, high, middle, slope: 0.0, origin: self.cursor.seen })
    }

    /// Change the levels; while they apply, their middle must remain between their thresholds.
    ///
    /// # Errors
    /// As [`Self::set_levels`].
    pub fn follow(&mut self, levels: Levels) -> Result<()> {
        levels.check()?;
        let previous = self.cursor.previous;
        let last = self.cursor.seen.wrapping_sub(1);
        if previous < self.levels.middle_at(last) && previous >= levels.middle_at(last) {
            // The last sample is below the old middle but not below the new one, so the crossing is at this sample.
            self.cursor.pending = Edge { time: last as f64, rise: f64::INFINITY };
        }
        self.levels = levels;
        Ok(())
    }

    /// Disarm the detector: only a further low sample arms it again.
    pub fn disarm(&mut self) {
        self.cursor.armed = false;
    }

    /// Number of samples so far.
    #[must_use]
    pub const fn seen(&self) -> u64 {
        self.cursor.seen
    }

    /// Stretches of missing samples, each from its first to one past its last. A stretch that is not over yet ends at
    /// [`Self::seen`]. If there are more than 65,536, the nearest are merged.
    pub fn gaps(&self) -> impl Iterator<Item = (u64, u64)> {
        let open = self.cursor.gap_start.map(|start| (start, self.cursor.seen));
        self.gaps.spans().chain(open)
    }

    /// Return the times of rising crossings in the next chunk, in samples from the first.
    ///
    /// # Errors
    /// If the sample type can't represent a threshold, or on a stop; the detector is then unchanged.
    pub fn feed<T: Sample>(&mut self, chunk: &[T], stop: &Stop) -> Result<Vec<f64>> {
        self.pass(chunk, stop)
    }

    /// As [`Self::feed`], each crossing with its rise.
    ///
    /// # Errors
    /// As [`Self::feed`].
    pub fn edges<T: Sample>(&mut self, chunk: &[T], stop: &Stop) -> Result<Vec<Edge>> {
        self.pass(chunk, stop)
    }

    fn pass<T: Sample, E: From<Edge>>(&mut self, chunk: &[T], stop: &Stop) -> Result<Vec<E>> {
        let thresholds = self.levels.thresholds()?;
        let found = passed(chunk, self.levels, self.cursor, thresholds, stop)?;
        Ok(self.taken(found))
    }

    /// Return the crossings as [`Self::edges`] does, for a chunk without gaps. `known` holds them for a detector whose
    /// armed state is `before`. None if this detector's state differs: the chunk must then be searched.
    pub(super) fn timed<T: Sample>(
        &mut self,
        chunk: &[T],
        known: (usize, Vec<Edge>),
        (before, after): (bool, bool),
    ) -> Option<Vec<Edge>> {
        (self.cursor.armed == before).then(|| {
            let found = timed(chunk, self.levels, self.cursor, known, after);
            self.taken(found)
        })
    }

    fn taken<E>(&mut self, found: Passed<E>) -> Vec<E> {
        self.cursor = found.cursor;
        found.gaps.into_iter().for_each(|gap| self.gaps.push(gap));
        found.edges
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Error;
    use proptest::prelude::*;

    fn run<T: Sample>(chunks: &[&[T]]) -> (Vec<f64>, Vec<(u64, u64)>) {
        let mut detector = PulseCrossings::new(1.0, 3.0, 2.0).unwrap();
        let times = chunks.iter().flat_map(|chunk| detector.feed(chunk, &Stop::new()).unwrap()).collect();
        (times, detector.gaps().collect())
    }

    /// The rules, applied sample by sample.
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
