//! Swings of a pulse train: turning points from the extremes of short blocks, and levels from the turning points.

use std::collections::VecDeque;

use multiversion::multiversion;

use super::sample::Sample;

/// Samples per block, the time resolution of a turning point.
pub const BLOCK: usize = 32;
const LANES: usize = 16;

/// Least swing in standard deviations of the noise; noise alone exceeds it once in millions of samples.
const CLEAR: f64 = 10.0;
/// Least swing as a share of the usual range of a block, if every block has a whole pulse and noise can't be measured.
/// Swings below this share of the largest nearby swing are ringing or noise on that swing.
const SHARE: f64 = 0.35;
/// One block in this many may be disturbed. In a slow train, only few of the other blocks have pulses.
const DISTURBED: usize = 500;
/// Least swing without noise, as a share of the range.
const RIPPLE: f64 = 0.01;
/// Number of swings on each side with which a swing is compared.
const NEAR: usize = 8;
/// Turning points per group; the medians of a group are one estimate of the low and the high level.
const GROUP: usize = 18;
/// Fewest turning points of a group.
const LEAST: usize = 4;
/// Time without a turning point after which a group ends, relative to the usual time between two turning points.
const SILENCE: f64 = 8.0;

/// Least and greatest usable sample of each block of 32, the last of which may be shorter; least above greatest if no sample
/// is usable.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl+avx512dq+avx2", "x86_64+avx2"))]
pub fn block_extremes<T: Sample>(samples: &[T], extremes: &mut Vec<(f64, f64)>) {
    let (blocks, rest) = samples.as_chunks::<BLOCK>();
    extremes.clear();
    extremes.reserve(blocks.len() + 1);
    for block in blocks {
        let mut low = [T::MOST; LANES];
        let mut high = [T::LEAST; LANES];
        for row in block.as_chunks::<LANES>().0 {
            // An iterator would keep the lanes in memory, so the loop uses indices. `&` evaluates both of its sides, which
            // compiles to a select instead of a branch.
            #[allow(clippy::needless_range_loop, clippy::needless_bitwise_bool)]
            for lane in 0..LANES {
                let x = row[lane];
                low[lane] = if (x >= T::LEAST) & (x < low[lane]) { x } else { low[lane] };
                high[lane] = if (x <= T::MOST) & (x > high[lane]) { x } else { high[lane] };
            }
        }
        extremes.push((reduced(&low, least).into(), reduced(&high, most).into()));
    }
    if !rest.is_empty() {
        let usable = || rest.iter().copied().filter(|&x| x >= T::LEAST && x <= T::MOST).map(Into::into);
        extremes.push((usable().fold(T::MOST.into(), f64::min), usable().fold(T::LEAST.into(), f64::max)));
    }
}

/// Reduction of all lanes, by halves: each half is one vector.
#[inline(always)]
pub(super) fn reduced<T: Sample>(lanes: &[T; LANES], of: impl Fn(T, T) -> T) -> T {
    let eight: [T; 8] = std::array::from_fn(|k| of(lanes[k], lanes[k + 8]));
    let four: [T; 4] = std::array::from_fn(|k| of(eight[k], eight[k + 4]));
    let two: [T; 2] = std::array::from_fn(|k| of(four[k], four[k + 2]));
    of(two[0], two[1])
}

#[inline(always)]
pub(super) fn least<T: Sample>(one: T, other: T) -> T {
    if other < one { other } else { one }
}

#[inline(always)]
pub(super) fn most<T: Sample>(one: T, other: T) -> T {
    if other > one { other } else { one }
}

/// Distance by which a signal must return from an extreme for it to be a turning point.
pub fn reversal(extremes: &[(f64, f64)], noise: f64) -> f64 {
    let mut ranges: Vec<f64> =
        extremes.iter().filter(|(low, high)| low <= high).map(|(low, high)| high - low).collect();
    if ranges.is_empty() {
        return 0.0;
    }
    let rare = ranges.len() - 1 - ranges.len() / DISTURBED;
    let rare = *ranges.select_nth_unstable_by(rare, f64::total_cmp).1;
    let middle = ranges.len() / 2;
    let usual = *ranges.select_nth_unstable_by(middle, f64::total_cmp).1;
    let clear = CLEAR * noise;
    let least = if usual > 0.5 * rare { clear.min(SHARE * usual) } else { clear };
    least.max(RIPPLE * rare)
}

/// A turning point: the first sample of its block, and the extreme.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turn {
    pub at: u64,
    pub value: f64,
}

/// Low and high level of a few pulses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Level {
    /// Middle sample of the pulses.
    pub centre: u64,
    /// Samples before the first and after the last turning point.
    pub span: (u64, u64),
    pub bottom: f64,
    pub top: f64,
    /// Standard deviation of the noise.
    pub noise: f64,
}

impl Level {
    pub fn height(&self) -> f64 {
        self.top - self.bottom
    }

    pub fn middle(&self) -> f64 {
        0.5 * (self.bottom + self.top)
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Going {
    Nowhere,
    Up,
    Down,
}

/// Finds turning points in the extremes of blocks.
#[derive(Debug, Clone)]
pub struct Swings {
    going: Going,
    /// Least and greatest value since the last turn; only the greatest is updated while the signal rises, only the least
    /// while it falls.
    low: Turn,
    high: Turn,
    /// Extremes of the previous block.
    before: (f64, f64),
}

impl Default for Swings {
    fn default() -> Self {
        let nothing = Turn { at: 0, value: f64::NAN };
        Self { going: Going::Nowhere, low: nothing, high: nothing, before: (f64::NAN, f64::NAN) }
    }
}

impl Swings {
    /// Process the blocks from sample `first` on.
    pub fn feed(&mut self, extremes: &[(f64, f64)], reversal: f64, first: u64, mut found: impl FnMut(Turn)) {
        for (&(low, high), at) in extremes.iter().zip((first..).step_by(BLOCK)) {
            if low > high {
                continue;
            }
            let before = std::mem::replace(&mut self.before, (low, high));
            let (low, high) = (Turn { at, value: low }, Turn { at, value: high });
            let first = self.low.value.is_nan();
            let lower = self.going != Going::Up && (first || low.value < self.low.value);
            let higher = self.going != Going::Down && (first || high.value > self.high.value);
            if lower {
                self.low = low;
            }
            if higher {
                self.high = high;
            }
            // In a block on a steep edge, one extreme belongs to the new swing and the other to the previous swing.
            let (rising, falling) = (higher && low.value > before.0, lower && high.value < before.1);
            match self.going {
                Going::Nowhere if self.high.value - self.low.value > reversal => {
                    let up = self.low.at <= self.high.at;
                    found(if up { self.low } else { self.high });
                    self.going = if up { Going::Up } else { Going::Down };
                }
                Going::Up if !rising && low.value < self.high.value - reversal => {
                    found(self.high);
                    (self.going, self.low) = (Going::Down, low);
                }
                Going::Down if !falling && high.value > self.low.value + reversal => {
                    found(self.low);
                    (self.going, self.high) = (Going::Up, high);
                }
                _ => {}
            }
        }
    }
}

/// Levels from turning points. Turning points of swings much smaller than nearby swings are dropped; the remaining ones
/// are grouped.
#[derive(Debug, Clone, Default)]
pub struct Grouping {
    /// Turning points whose swings have not been compared with nearby swings yet.
    turns: VecDeque<Turn>,
    /// The last turning point whose swing was compared.
    before: Option<Turn>,
    /// Index of the swing that ends at the first of `turns`; no swing ends at the record's first turning point.
    next: usize,
    /// Candidates for the largest nearby swing, with their indices; each is larger than all that follow.
    largest: VecDeque<(usize, f64)>,
    /// The extreme since the last accepted turn.
    held: Option<(Turn, bool)>,
    group: Vec<Turn>,
}

impl Grouping {
    /// Add a turning point; a completed group goes to `found`.
    pub fn push(&mut self, turn: Turn, noise: f64, found: &mut Vec<Level>) {
        if let Some(last) = self.turns.back().or(self.before.as_ref()) {
            let size = (turn.value - last.value).abs();
            while self.largest.back().is_some_and(|&(_, other)| other <= size) {
                self.largest.pop_back();
            }
            self.largest.push_back((self.next + self.turns.len(), size));
        }
        self.turns.push_back(turn);
        if self.turns.len() > NEAR {
            self.compare(noise, found);
        }
    }

    /// Levels of the turning points since the last complete group, as at the end of a record.
    pub fn rest(&self, noise: f64) -> Vec<Level> {
        let mut end = self.clone();
        let mut found = Vec::new();
        while !end.turns.is_empty() {
            end.compare(noise, &mut found);
        }
        if let Some((turn, _)) = end.held {
            end.take(turn, noise, &mut found);
        }
        end.close(noise, &mut found);
        found
    }

    /// Accept the next turning point if its swing is large enough compared with nearby swings.
    fn compare(&mut self, noise: f64, found: &mut Vec<Level>) {
        let Some(turn) = self.turns.pop_front() else { return };
        let swing = self.next;
        self.next += 1;
        let Some(before) = self.before.replace(turn) else { return };
        let Some((held, up)) = self.held else {
            self.take(before, noise, found);
            self.held = Some((turn, turn.value > before.value));
            return;
        };
        while self.largest.front().is_some_and(|&(number, _)| number + NEAR < swing) {
            self.largest.pop_front();
        }
        let largest = self.largest.front().map_or(0.0, |&(_, size)| size);
        let further = if up { turn.value - held.value } else { held.value - turn.value };
        if further > 0.0 {
            self.held = Some((turn, up));
        } else if -further > SHARE * largest {
            self.take(held, noise, found);
            self.held = Some((turn, !up));
        }
    }

    fn take(&mut self, turn: Turn, noise: f64, found: &mut Vec<Level>) {
        if let [first, .., last] = self.group[..]
            && self.group.len() >= LEAST
        {
            let usual = (last.at - first.at) as f64 / (self.group.len() - 1) as f64;
            if (turn.at - last.at) as f64 > SILENCE * usual.max(BLOCK as f64) {
                self.close(noise, found);
            }
        }
        self.group.push(turn);
        if self.group.len() == GROUP {
            self.close(noise, found);
        }
    }

    fn close(&mut self, noise: f64, found: &mut Vec<Level>) {
        if let [first, .., last] = self.group[..]
            && self.group.len() >= LEAST
        {
            let one = median(self.group.iter().step_by(2));
            let other = median(self.group.iter().skip(1).step_by(2));
            found.push(Level {
                centre: u64::midpoint(first.at, last.at) + BLOCK as u64 / 2,
                span: (first.at, last.at + BLOCK as u64),
                bottom: one.min(other),
                top: one.max(other),
                noise,
            });
        }
        self.group.clear();
    }
}

fn median<'a>(turns: impl Iterator<Item = &'a Turn>) -> f64 {
    let mut sorted = [0.0; GROUP];
    let mut count = 0;
    for turn in turns {
        let mut place = count;
        while place > 0 && sorted[place - 1] > turn.value {
            sorted[place] = sorted[place - 1];
            place -= 1;
        }
        sorted[place] = turn.value;
        count += 1;
    }
    0.5 * (sorted[(count - 1) / 2] + sorted[count / 2])
}
