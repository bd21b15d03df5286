//! Fuzz test: millions of adversarial trains, levels and chunks, compared with a slow detector that works sample by sample.
//!
//! `cargo test --release pulse_fuzz -- --ignored --nocapture` runs ten million.

use super::thresholds::Levels;
use super::{PulseCrossings, PulseTracker, Sample, pulse_levels};
use crate::stop::Stop;

/// A sample type that converts from any f64, by rounding or clamping.
trait Any: Sample {
    fn of(x: f64) -> Self;
}

impl Any for f64 {
    fn of(x: f64) -> Self {
        x
    }
}

#[allow(clippy::cast_possible_truncation)] // intended
impl Any for f32 {
    fn of(x: f64) -> Self {
        x as Self
    }
}

#[allow(clippy::cast_possible_truncation)] // `as` clamps; NaN becomes 0
impl Any for i16 {
    fn of(x: f64) -> Self {
        x as Self
    }
}

/// `SplitMix64` (doi:10.1145/2660193.2660195): fast, with any seed.
struct Draw(u64);

impl Draw {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    #[allow(clippy::cast_possible_truncation)] // far below 2^32
    fn below(&mut self, n: usize) -> usize {
        (((self.next() >> 32) * n as u64) >> 32) as usize
    }

    fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Random levels, returned as low, high, middle, with low < middle < high; the scale is random, too.
    fn levels(&mut self) -> [f64; 3] {
        let scale = [1.0, 1.0, 1000.0, 32_767.0, 5e-324, 1e-310, 1e30, 1e39, 1e308][self.below(9)];
        loop {
            let mut three: [f64; 3] = std::array::from_fn(|_| {
                scale * [self.unit() * 3.0 - 1.5, self.below(5) as f64 - 2.0][self.below(2)]
            });
            three.sort_by(f64::total_cmp);
            let [low, middle, high] = three;
            if low < middle && middle < high && low.is_finite() && high.is_finite() {
                return [low, high, middle];
            }
        }
    }

    fn value(&mut self, [low, high, middle]: [f64; 3]) -> f64 {
        match self.below(24) {
            0..=4 => low,
            5..=9 => high,
            10 => middle,
            11 => [low, high, middle][self.below(3)].next_up(),
            12 => [low, high, middle][self.below(3)].next_down(),
            13 => f64::NAN,
            14 => f64::INFINITY,
            15 => f64::NEG_INFINITY,
            16 => {
                [f64::MAX, f64::MIN, 5e-324, -5e-324, 0.0, -0.0, 1e-310, f64::from(f32::MAX)][self.below(8)]
            }
            17 => f64::from_bits(self.next()),
            18 | 19 => middle + (high - middle) * self.unit(),
            20 | 21 => low + (middle - low) * self.unit(),
            _ => low + (high - low) * (3.0 * self.unit() - 1.0),
        }
    }

    /// A train of runs and noise, sometimes longer than the detector's batch.
    fn train<T: Any>(&mut self, levels: [f64; 3]) -> Vec<T> {
        let length = if self.below(4096) == 0 { self.below(10_000) } else { self.below(150) };
        let mut train = Vec::with_capacity(length);
        while train.len() < length {
            let run = if self.below(10) == 0 { 1 + self.below(80) } else { 1 };
            let x = T::of(self.value(levels));
            train.extend(std::iter::repeat_n(x, run.min(length - train.len())));
        }
        train
    }
}

/// The rules, applied sample by sample.
struct Reference {
    levels: Levels,
    seen: u64,
    armed: bool,
    previous: f64,
    crossing: f64,
    times: Vec<f64>,
    gaps: Vec<(u64, u64)>,
}

impl Reference {
    fn new([low, high, middle]: [f64; 3]) -> Self {
        let (times, gaps) = (vec![], vec![]);
        let levels = Levels { low, high, middle, slope: 0.0, origin: 0 };
        Self { levels, seen: 0, armed: false, previous: f64::NAN, crossing: f64::NAN, times, gaps }
    }

    fn middle(levels: &Levels, sample: f64) -> f64 {
        levels.middle + levels.slope * (sample - levels.origin as f64)
    }

    fn follow(&mut self, levels: Levels) {
        let last = self.seen as f64 - 1.0;
        if self.previous < Self::middle(&self.levels, last) && self.previous >= Self::middle(&levels, last) {
            self.crossing = last;
        }
        self.levels = levels;
    }

    fn take(&mut self, x: f64) {
        let Levels { low, high, .. } = self.levels;
        let k = self.seen;
        let (below, middle) =
            (Self::middle(&self.levels, k as f64 - 1.0), Self::middle(&self.levels, k as f64));
        if x.is_nan() {
            self.armed = false;
            match self.gaps.last_mut() {
                Some(gap) if gap.1 == k => gap.1 += 1,
                _ => self.gaps.push((k, k + 1)),
            }
        }
        if self.previous < below && x >= middle {
            let rise = (x - self.previous) - (middle - below);
            self.crossing = if rise.is_finite() { k as f64 - (x - middle) / rise } else { k as f64 };
        }
        if x <= low {
            self.armed = true;
        } else if self.armed && x >= high {
            self.times.push(self.crossing);
            self.armed = false;
        }
        self.previous = x;
        self.seen += 1;
    }
}

#[derive(Default)]
struct Tally {
    samples: usize,
    crossings: usize,
    gaps: usize,
    refused: usize,
}

/// Test one train, fed whole or in chunks, with occasional changes of levels between them.
fn execute<T: Any>(draw: &mut Draw, tally: &mut Tally) {
    let mut levels = draw.levels();
    let train: Vec<T> = draw.train(levels);
    let mut detector = PulseCrossings::new(levels[0], levels[1], levels[2]).unwrap();
    let mut reference = Reference::new(levels);
    let mut times = Vec::new();
    let most = [train.len() + 1, 1 + draw.below(70), 65][draw.below(3)];
    let mut rest = &train[..];
    while !rest.is_empty() {
        if draw.below(8) == 0 {
            levels = draw.levels();
            let [low, high, middle] = levels;
            // By the end of the train the middle moves at most half the distance to a threshold.
            let [down, up] = [low, high].map(|end| (0.5 * end - 0.5 * middle) / (rest.len() + 1) as f64);
            let slope = [0.0, down, up, up * draw.unit()][draw.below(4)];
            let line = Levels { low, high, middle, slope, origin: reference.seen };
            detector.follow(line).unwrap();
            reference.follow(line);
        }
        let (chunk, after) = rest.split_at(draw.below(most.min(rest.len()) + 1));
        match detector.feed(chunk, &Stop::new()) {
            Ok(found) => {
                times.extend(found);
                for &x in chunk {
                    reference.take(x.into());
                }
            }
            Err(_) => tally.refused += 1, // a level outside the sample type; the chunk has no effect
        }
        // An empty chunk is a test case, but must not repeat forever.
        rest = if chunk.is_empty() && draw.below(2) == 0 { &rest[1..] } else { after };
    }
    let bits = |times: &[f64]| times.iter().map(|t| t.to_bits()).collect::<Vec<_>>();
    let gaps: Vec<_> = detector.gaps().collect();
    let same =
        bits(&times) == bits(&reference.times) && gaps == reference.gaps && detector.seen() == reference.seen;
    assert!(
        same,
        "{} {levels:?}: {times:?}, expected {:?}; {gaps:?}, expected {:?}",
        T::NAME,
        reference.times,
        reference.gaps
    );

    let (low, high) = pulse_levels(&train, &Stop::new()).unwrap();
    // `pulse_levels` treats samples beyond a quarter of the largest floating-point number as saturated.
    let finite = || train.iter().map(|&x| x.into()).filter(|x: &f64| x.abs() <= f64::MAX / 4.0);
    let (least, most) = (finite().fold(f64::INFINITY, f64::min), finite().fold(f64::NEG_INFINITY, f64::max));
    if least > most {
        assert!(low.is_nan() && high.is_nan());
    } else {
        assert!(least <= low && low <= high && high <= most, "levels {low} {high} of {least} to {most}");
    }
    track(&train, draw);
    tally.samples += train.len();
    tally.crossings += times.len();
    tally.gaps += gaps.len();
}

/// Windows of any length give ordered crossings within the record, as many heights and deviations, and the same gaps.
fn track<T: Any>(train: &[T], draw: &mut Draw) {
    let given = |draw: &mut Draw, value: f64| (draw.below(4) == 0).then_some(value);
    let [low, high, middle] = draw.levels();
    let fits = T::at_or_below(low).is_some() && T::at_or_above(high).is_some();
    let threshold = given(draw, middle).filter(|_| fits);
    let hysteresis = given(draw, (high - low).min(f64::MAX)).filter(|width| fits && *width > 0.0);
    if threshold.is_some() && hysteresis.is_some() {
        return; // the crossings above
    }
    let mut tracker = PulseTracker::new(threshold, hysteresis).unwrap();
    let size = 1 + draw.below(train.len() + 1);
    let (mut last, mut seen) = (0.0_f64, 0);
    let windows: Vec<&[T]> = train.chunks(size).collect();
    for k in 0..=windows.len() {
        if let Some(window) = windows.get(k) {
            tracker.look(window, &Stop::new()).unwrap();
        }
        let Some(window) = k.checked_sub(1).map(|k| windows[k]) else { continue };
        seen += window.len();
        // A given width may be outside the sample type.
        let Ok(pulses) = tracker.cross(window, &Stop::new()) else { return };
        for (&time, &height) in pulses.times.iter().zip(&pulses.heights) {
            assert!(last <= time && time <= seen as f64, "{time} after {last}, {seen} samples");
            assert!(height >= 0.0, "height {height}");
            last = time;
        }
        let count = pulses.times.len();
        assert_eq!([pulses.heights.len(), pulses.timing.grid.len(), pulses.timing.noise.len()], [count; 3]);
        let deviations = || pulses.timing.grid.iter().chain(&pulses.timing.noise);
        assert!(deviations().all(|std| *std >= 0.0), "{:?}", pulses.timing);
    }
    let missing = train.iter().filter(|x| x.is_gap()).count();
    let found: u64 = tracker.gaps().map(|(from, to)| to - from).sum();
    assert_eq!(found, missing as u64);
}

fn fuzz(executions: usize) -> Tally {
    let mut tally = Tally::default();
    for seed in 0..executions {
        let mut draw = Draw((seed as u64).wrapping_mul(0x2545_f491_4f6c_dd1d));
        match seed % 3 {
            0 => execute::<f64>(&mut draw, &mut tally),
            1 => execute::<f32>(&mut draw, &mut tally),
            _ => execute::<i16>(&mut draw, &mut tally),
        }
    }
    tally
}

#[test]
fn a_few_adversarial_trains_give_what_the_rules_say() {
    let Tally { crossings, gaps, .. } = fuzz(30_000);
    assert!(crossings > 30_000 && gaps > 10_000, "too tame: {crossings} crossings, {gaps} gaps");
}

#[test]
#[ignore = "ten million trains; run in release"]
fn pulse_fuzz() {
    let executions = 10_000_000;
    let Tally { samples, crossings, gaps, refused } = fuzz(executions);
    println!(
        "pulse fuzz: {executions} executions, {samples} samples, {crossings} crossings, {gaps} gaps, {refused} chunks \
         refused, all as the reference says"
    );
}
